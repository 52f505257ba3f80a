"""Small things on tables, shelves and floors: crockery, bottles, fruit, computers, toys."""

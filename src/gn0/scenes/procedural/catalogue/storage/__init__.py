"""Storage and beds: bookshelves with their books, wardrobes, dressers, racks, shelves, beds."""

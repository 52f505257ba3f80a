"""Things of yards and gardens: a fountain, benches, bicycles, tables, playthings."""

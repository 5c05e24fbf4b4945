"""All records of many installations in one PostgreSQL, from a process of its own."""

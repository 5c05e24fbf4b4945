"""`heliocube archive`: all records of many services in one PostgreSQL."""

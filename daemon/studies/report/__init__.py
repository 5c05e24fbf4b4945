"""A day, a week or a month of one tracker as one page: what it did, what it gained, how good the records are."""

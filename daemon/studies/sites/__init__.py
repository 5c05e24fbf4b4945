"""The energy benchmark at many sites: a table of them, their weather, and what all of them show."""

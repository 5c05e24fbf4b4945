"""The energy benchmark at many sites: the table of sites, their weather, and the results of all."""

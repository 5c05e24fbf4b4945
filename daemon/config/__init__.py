"""The configuration: its sections, the file they are read from, and the page that documents them."""

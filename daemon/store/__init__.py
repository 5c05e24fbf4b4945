"""What the service keeps on disk: the tables of records, and their export."""

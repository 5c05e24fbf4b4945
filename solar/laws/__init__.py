"""The laws that point: the paper's own, and the one that seeks most light."""

"""The port of the local interface: who gets in, and for how long a connection is kept."""

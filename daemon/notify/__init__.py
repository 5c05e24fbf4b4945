"""Alarms to people, from a process of its own: it knows services by their HTTP interface alone."""

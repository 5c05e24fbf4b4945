"""The dashboard for people's browsers, a process of its own that knows services by their HTTP interfaces alone."""

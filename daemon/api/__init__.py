"""The local HTTP interface: what the service shows of itself, and the operator's commands."""

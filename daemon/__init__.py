"""The service: acquisition, bridge, control and motion, and the command line that starts them."""

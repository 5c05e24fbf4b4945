"""Any rotator that Hamlib knows, through its server rotctld: wire format, mount, and the driver above them."""

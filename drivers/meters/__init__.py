"""What measures the voltage of a sensor."""

"""What switches the inputs of a meter from sensor to sensor."""

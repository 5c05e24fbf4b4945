"""Simulated instruments on Modbus: pyranometers on one line, each with its registers, moods and faults."""

"""What every room stands on: records, clocks, errors, alarms, files, and how an outage is told."""

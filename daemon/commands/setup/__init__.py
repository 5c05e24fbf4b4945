"""`heliocube setup`: questions, looks at the instruments and the first move, before the configuration is written."""

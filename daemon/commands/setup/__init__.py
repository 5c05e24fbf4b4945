"""`heliocube setup`: what a new rig is asked, looked at and moved by, before its configuration is written."""

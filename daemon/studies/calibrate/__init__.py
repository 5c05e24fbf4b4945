"""`heliocube calibrate`: request, evaluation, report and figures."""

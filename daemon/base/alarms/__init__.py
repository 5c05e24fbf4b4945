"""What a person has to know: which alarms there are, what each is worth, and who has acknowledged it."""

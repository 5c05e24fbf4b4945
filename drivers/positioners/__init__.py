"""What turns a tracker: one module or folder for each make."""

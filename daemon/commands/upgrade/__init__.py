"""What is done around a change of the release: looking whether all is well, and going back."""

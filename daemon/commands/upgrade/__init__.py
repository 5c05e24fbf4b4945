"""Commands around a change of the release: the self-check, and the way back."""

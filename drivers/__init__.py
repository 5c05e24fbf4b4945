"""Instruments: what each can do, how it fails and how it speaks. No policy, no retries."""

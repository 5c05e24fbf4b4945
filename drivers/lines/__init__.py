"""Lines to instruments: serial ports, VISA resources, and the thread that blocking calls live in."""

"""Where the local interface is unless the configuration says otherwise."""

DEFAULT_LISTEN = "127.0.0.1:20572"

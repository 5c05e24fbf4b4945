"""The simulator cores on real transports: pseudo-terminals, and a mock NI gRPC device server."""

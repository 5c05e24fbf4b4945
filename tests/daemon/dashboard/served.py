"""A dashboard that is served on a port of this machine."""

import asyncio
import os
import signal
from contextlib import asynccontextmanager

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.base.process import SystemdNotifier
from daemon.dashboard.serve import bind, serve


@asynccontextmanager
async def served(service="127.0.0.1:9"):
    """Give the address of a dashboard."""
    bound = bind("127.0.0.1:0")
    address = bound.getsockname()
    serving = asyncio.create_task(
        serve(bound, [parse_address(service)], [], SystemClock(), SystemdNotifier({}, os.getpid()))
    )
    try:
        yield address
    finally:
        signal.raise_signal(signal.SIGTERM)
        await serving

"""Activities in asyncio. A cancelled task cancels its activity, and ends when the robot is at rest."""

from __future__ import annotations

import asyncio

from ._takt import Handle, Outcome


async def wait(handle: Handle) -> Outcome:
    """The outcome of an activity, without blocking the loop."""
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[None] = loop.create_future()

    def end() -> None:
        if not ended.done():
            ended.set_result(None)

    def wake() -> None:
        try:
            loop.call_soon_threadsafe(end)
        except RuntimeError:
            pass  # The loop is closed: no task waits any more.

    handle._wake(wake)
    try:
        await asyncio.shield(ended)
    except asyncio.CancelledError:
        await loop.run_in_executor(None, handle.cancel)
        await asyncio.shield(ended)
        raise
    return handle.wait()

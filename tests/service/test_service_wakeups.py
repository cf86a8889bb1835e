"""Waking whoever waits for a job: only those concerned, everybody after a gap, and nobody for ever."""

import asyncio
import time

import pytest

from service.wakeups import POLL_BLIND_S, Wakeups
from worker.queue import Queue
from worker.wire import connect


def test_only_those_whom_a_message_concerns_are_woken() -> None:
    async def run() -> list[bool]:
        hub = Wakeups(None)
        with (
            hub.waiting("a") as any_news,
            hub.waiting("a", end_only=True) as the_end,
            hub.waiting("b") as another,
        ):
            hub.hear("a 3 rendering")
            first = [await waiter.wait(0.0) for waiter in (any_news, the_end, another)]
            hub.hear("a 4 succeeded")
            return first + [await waiter.wait(0.0) for waiter in (any_news, the_end, another)]

    assert asyncio.run(run()) == [True, False, False, True, True, False]


def test_a_message_between_two_waits_is_not_lost_and_counts_once() -> None:
    async def run() -> list[bool]:
        hub = Wakeups(None)
        with hub.waiting("a") as waiter:
            hub.hear("a 2 preparing")
            hub.hear("a 3 rendering")
            return [await waiter.wait(0.0), await waiter.wait(0.0)]

    assert asyncio.run(run()) == [True, False]


def test_nobody_waits_longer_than_a_poll_without_looking() -> None:
    async def run() -> bool:
        with Wakeups(None).waiting("a") as waiter:
            return await waiter.wait(60.0)

    began = time.monotonic()
    assert not asyncio.run(run())
    assert POLL_BLIND_S * 0.9 < time.monotonic() - began < 10 * POLL_BLIND_S


def test_closing_wakes_all() -> None:
    async def run() -> bool:
        hub = Wakeups(None)
        with hub.waiting("a", end_only=True) as waiter:
            hub.close()
            return hub.closing and await waiter.wait(60.0)

    assert asyncio.run(run())


def test_a_lost_subscription_comes_back_and_wakes_all(redis_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.wakeups._RECONNECT_S", 0.01)

    async def until(connected: bool, hub: Wakeups) -> None:
        for _ in range(5000):
            if hub.connected is connected:
                return
            await asyncio.sleep(0.001)
        raise AssertionError(hub.connected)

    async def run() -> list[bool]:
        hub = Wakeups(redis_url)
        hub.start()
        client = connect(redis_url)
        with hub.waiting("a", end_only=True) as waiter:
            await until(True, hub)
            await waiter.wait(0.0)
            client.client_kill_filter(_type="pubsub")
            await until(False, hub)
            await until(True, hub)
            back = await waiter.wait(0.0)
            client.publish("sm:events", "a 9 failed")
            told = await waiter.wait(5.0)
        await hub.stop()
        return [back, told]

    assert asyncio.run(run()) == [True, True]


def test_stop_before_the_first_connection(redis_url: str) -> None:
    async def run() -> None:
        hub = Wakeups(redis_url)
        hub.start()
        await hub.stop()
        assert hub.closing

    asyncio.run(run())
    assert Queue(redis_url).ping()

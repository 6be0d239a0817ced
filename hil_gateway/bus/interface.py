"""One interface, two buses: Zenoh between processes, and a local one for whole loops in a single process.

A subscriber never queues without limit: `latest` keeps the newest message, `queue` keeps the newest `depth`
and counts what it dropped.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Generic, Protocol, TypeVar

from hil_gateway.bus.latest import Latest
from hil_gateway.bus.messages import Message
from hil_gateway.bus.topics import Topic

M = TypeVar("M", bound=Message)


class Subscription(Protocol[M]):
    """Pull interface of one subscriber; nothing happens in the background of the caller."""

    dropped: int

    def poll(self, now_ns: int) -> list[M]:
        """Messages received since the last call, oldest first."""
        ...


class Bus(Protocol):
    """Publish and subscribe by entries of the topics table."""

    def publish(self, topic: Topic[M], message: M) -> None:
        """Send one message; never blocks for a slow reader."""
        ...

    def subscribe(self, topic: Topic[M], depth: int = 1) -> Subscription[M]:
        """Subscribe; at most `depth` unread messages are kept, the oldest are dropped and counted."""
        ...

    def close(self) -> None:
        """Release every resource; further calls are errors."""
        ...


class LatestReader(Generic[M]):
    """Newest message of a topic with its age: a subscription of depth one behind a `Latest`."""

    def __init__(self, bus: Bus, topic: Topic[M]) -> None:
        self._subscription = bus.subscribe(topic, depth=1)
        self.latest: Latest[M] = Latest(topic.deadline_s)

    def update(self, now_ns: int) -> Latest[M]:
        """Take in what has arrived; returns the holder."""
        for message in self._subscription.poll(now_ns):
            self.latest.put(message, now_ns)
        return self.latest


class LocalSubscription(Generic[M]):
    """Bounded queue filled synchronously by `LocalBus.publish`."""

    def __init__(self, depth: int) -> None:
        self._messages: deque[M] = deque(maxlen=depth)
        self.dropped = 0

    def push(self, message: M) -> None:
        """Add a message, dropping the oldest when full."""
        self.dropped += len(self._messages) == self._messages.maxlen
        self._messages.append(message)

    def poll(self, now_ns: int) -> list[M]:
        if not self._messages:
            return []
        messages = list(self._messages)
        self._messages.clear()
        return messages


class LocalBus:
    """Synchronous, deterministic bus inside one process."""

    def __init__(self) -> None:
        self._subscriptions: dict[str, list[LocalSubscription[Any]]] = {}

    def publish(self, topic: Topic[M], message: M) -> None:
        for subscription in self._subscriptions.get(topic.key, ()):
            subscription.push(message)

    def subscribe(self, topic: Topic[M], depth: int = 1) -> LocalSubscription[M]:
        subscription: LocalSubscription[M] = LocalSubscription(depth)
        self._subscriptions.setdefault(topic.key, []).append(subscription)
        return subscription

    def close(self) -> None:
        self._subscriptions.clear()

"""Where lines come from: standard input or an MQTT broker, by a bounded queue: a slow reader never grows memory."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from queue import Empty, Queue
from threading import Thread

from hydro_env import ConfigurationError
from hydro_env.errors import reason

MOST_LINES = 10_000  # that wait; the source then waits, too
PATIENCE = 1.0  # s


def lines_of(fill: Callable[[Callable[[str], None]], None]) -> Iterator[str | None]:
    """The lines that ``fill`` puts from a thread of its own; ``None`` after each second without a line."""
    queue: Queue[str | Exception | None] = Queue(MOST_LINES)

    def run() -> None:
        try:
            fill(queue.put)
            queue.put(None)
        except Exception as error:  # of any library; the reader must not wait for ever
            queue.put(error)

    thread = Thread(target=run, daemon=True)
    thread.start()
    while True:
        try:
            line = queue.get(timeout=PATIENCE)
        except Empty:
            yield None
            continue
        if line is None:  # the end of the input
            return
        if isinstance(line, Exception):
            raise ConfigurationError(f"rows: cannot be read: {reason(line)}")
        yield line


def standard_input(put: Callable[[str], None]) -> None:
    """All lines of the standard input."""
    for line in sys.stdin:
        put(line)


def broker(address: str) -> Callable[[Callable[[str], None]], None]:
    """The lines of all messages of a topic, HOST[:PORT]/TOPIC; the client connects again by itself.

    Raises:
        ConfigurationError: paho-mqtt is missing, the address is none, or nobody listens there.
    """
    place, _, topic = address.partition("/")
    host, _, port = place.partition(":")
    if not host or not topic or not (port or "1883").isdigit():
        raise ConfigurationError(f"--mqtt {address}: must be HOST[:PORT]/TOPIC, such as localhost/press/#")
    try:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise ConfigurationError("--mqtt: needs paho-mqtt: pip install 'hydro_env[mqtt]'") from None
    # A name of its own, under which the broker keeps rows while this client is away.
    client = Client(CallbackAPIVersion.VERSION2, client_id=f"hydro_watch {topic}", clean_session=False)
    client.reconnect_delay_set(max_delay=30)

    def on_connect(*_: object) -> None:
        client.subscribe(topic, qos=1)

    client.on_connect = on_connect

    def fill(put: Callable[[str], None]) -> None:
        def on_message(_client: object, _data: object, message: object) -> None:
            for line in message.payload.decode(errors="replace").splitlines():  # type: ignore[attr-defined]
                put(line)

        client.on_message = on_message
        client.loop_forever(retry_first_connection=True)

    try:
        client.connect(host, int(port or 1883))
    except OSError as error:
        raise ConfigurationError(f"--mqtt {address}: {error}") from None
    return fill

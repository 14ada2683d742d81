"""MQTT through paho-mqtt: a topic per kind of record, whose messages are the lines of JSON.

``status`` is retained: "online", or "offline" as the connection's last will.
"""

import os
import ssl
import threading
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Final
from urllib.parse import SplitResult, unquote

from monitor.base.errors import UsageError
from monitor.sinks.record import Record, Tags, json_of

TIMEOUT_S: Final = 5.0
KEEPALIVE_S: Final = 30
PACKET_MOST: Final = 1_000_000  # bytes of a packet from the broker, which has little to tell
QOS: Final = 1  # at least once: the broker confirms every message
PASSWORD: Final = "MQTT_PASSWORD"  # variable of the environment
TOPIC: Final = "o2mon"


class Mqtt:
    """Publishes records under a topic.

    Raises UsageError if paho-mqtt is missing or the address has no host.
    """

    def __init__(self, url: SplitResult, tags: Tags) -> None:
        if find_spec("paho") is None:
            raise UsageError(
                "a sink mqtt:// needs paho-mqtt: pip install '.[mqtt]' in the project's folder"
            )
        if not url.hostname:
            raise UsageError("an MQTT sink needs a host: mqtt://HOST:1883/TOPIC")
        self._is_safe = url.scheme == "mqtts"
        self._host, self._port = url.hostname, url.port or (8883 if self._is_safe else 1883)
        self._topic = url.path.strip("/") or TOPIC
        if any(sign in self._topic for sign in "+#"):
            raise UsageError("a topic to publish under has no + and no #")  # it may hold a password
        self._user = unquote(url.username) if url.username else None
        self._password = unquote(url.password) if url.password else os.environ.get(PASSWORD)
        self._tags = dict(tags)
        self._client: Any = None

    def write(self, records: Sequence[Record]) -> None:
        """Publish the records and wait until the broker has confirmed them.

        Raises OSError if there is no connection, or nothing is confirmed for ``TIMEOUT_S``.
        """
        client = self._client or self._open()
        for sent in [
            client.publish(f"{self._topic}/{record.kind}", json_of(record, self._tags), qos=QOS)
            for record in records
        ]:
            if sent.rc:
                raise OSError("the connection is lost")
            sent.wait_for_publish(TIMEOUT_S)
            if not sent.is_published():
                raise OSError(f"no confirmation within {TIMEOUT_S:g} s")

    def _open(self) -> Any:
        from paho.mqtt.client import Client  # noqa: PLC0415 - an extra's
        from paho.mqtt.enums import CallbackAPIVersion  # noqa: PLC0415

        answered, refusals = threading.Event(), []

        def on_connect(client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
            if code.is_failure:
                refusals.append(str(code))
            else:  # also where paho has connected again, behind the last will
                client.publish(f"{self._topic}/status", "online", qos=QOS, retain=True)
            answered.set()

        class Bounded(Client):
            """A client that ends the connection at a packet that could fill the memory."""

            def _sock_recv(self, bufsize: int) -> bytes:
                if bufsize > PACKET_MOST:
                    raise ConnectionError(f"a packet of {bufsize} bytes from the broker")
                found: bytes = super()._sock_recv(bufsize)
                return found

        client = Bounded(CallbackAPIVersion.VERSION2)
        client.max_inflight_messages_set(1000)
        client.connect_timeout = TIMEOUT_S
        client.on_connect = on_connect
        if self._user is not None:
            client.username_pw_set(self._user, self._password)
        if self._is_safe:
            client.tls_set_context(ssl.create_default_context())
        client.will_set(f"{self._topic}/status", "offline", qos=QOS, retain=True)
        self._client = client
        client.connect(self._host, self._port, KEEPALIVE_S)
        client.loop_start()
        if not answered.wait(TIMEOUT_S):
            raise OSError(f"no answer to the connection within {TIMEOUT_S:g} s")
        if refusals:
            raise OSError(f"the broker refuses the connection: {refusals[0]}")
        return client

    def close(self) -> None:
        """Say "offline" and end the connection."""
        client, self._client = self._client, None
        if client is None:
            return
        client.on_connect = None
        if client.is_connected():
            said = client.publish(f"{self._topic}/status", "offline", qos=QOS, retain=True)
            if not said.rc:
                said.wait_for_publish(1.0)
        client.disconnect()
        client.loop_stop()

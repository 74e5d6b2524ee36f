"""The connection to an MQTT broker; the only module that uses paho-mqtt.

The session outlasts the connection: what is sent with QoS 1 while the agent is disconnected arrives
later. A message is acknowledged only after it was carried out; otherwise the broker sends it again.
It also does that if the connection ended before the acknowledgement arrived: such a copy has the
number of the first one, and a mark.
"""

from __future__ import annotations

import queue
import ssl
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.report import Reporter
from rigel_muto.agent.address import Address, Login
from rigel_muto.agent.commands import Arrival, Message

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
    from paho.mqtt.reasoncodes import ReasonCode

#: Seconds that the broker keeps messages for a disconnected agent.
KEPT = 24 * 3600
#: Seconds between two signs of life on a connection, and that connecting may take.
KEEPALIVE, PATIENCE = 30, 10
#: Seconds before the next attempt to connect: at first, and at most. A connection that lasted
#: longer than the latter counts as good.
FIRST, LONGEST = 0.5, 30.0
#: Messages that the broker may send before one is acknowledged, and the bytes of one.
MOST_AT_ONCE, MOST_BYTES = 50, 4 * 2**20
#: Answers that wait for the broker to return, and messages of QoS 0 that wait for their turn.
MOST_ANSWERS = MOST_WAITING = 1000

#: Messages that are remembered: more than brokers may send without an acknowledgement.
REMEMBERED = 500


@attrs.frozen(kw_only=True)
class Delivery:
    """A message as the broker sent it.

    Attributes:
        number: MQTT's packet identifier; 0 for QoS 0.
        kept: the broker keeps it until it is acknowledged (QoS 1).
        again: the broker marks it as a copy.
        connection: the number of the connection that it came by; only there it can be acknowledged.
        session: the number of the broker's session, which may outlast connections.
    """

    arrival: Arrival
    number: int = 0
    kept: bool = False
    again: bool = False
    connection: int = 0
    session: int = 0


class CarriedOut:
    """Messages of one session that were carried out, perhaps unnoticed by the broker."""

    def __init__(self) -> None:
        self._done: OrderedDict[tuple[int, int], Arrival] = OrderedDict()

    def note(self, delivery: Delivery) -> None:
        """Remember that a message was carried out."""
        if not delivery.kept:
            return
        key = (delivery.session, delivery.number)
        self._done[key] = delivery.arrival
        self._done.move_to_end(key)
        if len(self._done) > REMEMBERED:
            self._done.popitem(last=False)

    def knows(self, delivery: Delivery) -> bool:
        """Return whether a message is the copy of one that was carried out."""
        if not (delivery.kept and delivery.again):
            return False
        return self._done.get((delivery.session, delivery.number)) == delivery.arrival


class Broker:
    """A client of one broker. Use it as a context manager: it connects, and stays connected.

    Args:
        client_id: the session's name; two clients must not use one at the same time.
        topics: what to subscribe to.
    """

    def __init__(
        self,
        address: Address,
        login: Login,
        client_id: str,
        topics: Iterable[str],
        reporter: Reporter,
    ) -> None:
        self._address = address
        self._login = login
        self._topics = tuple(topics)
        self._reporter = reporter
        self._deliveries: queue.SimpleQueue[Delivery] = queue.SimpleQueue()
        self._carried_out = CarriedOut()
        self._lock = threading.Lock()
        self._connection = self._session = 0
        self._is_open = False
        self._cause = ""
        self._trouble = f"connecting to {address}"
        self._troubles: set[str] = set()
        self._ready = threading.Event()
        self._ending = threading.Event()
        self._context = login.make_context() if address.tls else None
        self._client = self._make_client(client_id)
        self._thread = threading.Thread(target=self._stay_connected, name="broker", daemon=True)

    def _make_client(self, client_id: str) -> Client:
        try:
            from paho.mqtt.client import Client, MQTTv5
            from paho.mqtt.enums import CallbackAPIVersion
        except ModuleNotFoundError as error:
            raise UserError(
                "Muto's agent needs paho-mqtt, which is not installed",
                hint="pip install 'rigel-k8s[muto]'",
            ) from error
        client = Client(
            CallbackAPIVersion.VERSION2,
            client_id,
            protocol=MQTTv5,
            reconnect_on_failure=False,
            manual_ack=True,
        )
        if self._context:
            client.tls_set_context(self._context)
        client.connect_timeout = PATIENCE
        client.max_queued_messages_set(MOST_ANSWERS)
        client.on_connect = self._begin
        client.on_subscribe = self._check_subscription
        client.on_disconnect = self._end
        client.on_message = self._take
        # With a callback here, publish and ack leave the writing to the thread with the loop.
        client.on_socket_register_write = lambda *_: None
        return client

    def __enter__(self) -> Broker:
        """Begin to connect, without waiting for it."""
        self._prepare()  # a missing file is an error at once; later it may exist again
        if self._login.user and self._address.is_readable_by_others:
            self._reporter.warn(
                f"the password for {self._address} is sent without encryption: use mqtts://"
            )
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection; the session stays."""
        self._ending.set()
        self._client.disconnect()
        self._thread.join(PATIENCE)
        # paho-mqtt closes its sockets when its client is freed, which the callbacks would prevent.
        client = self._client
        client.on_connect = client.on_subscribe = client.on_disconnect = client.on_message = None

    @property
    def is_ready(self) -> bool:
        """Whether messages arrive."""
        return self._ready.is_set()

    @property
    def trouble(self) -> str:
        """Why no messages come in; "" while they do."""
        return "" if self.is_ready else self._trouble

    def next(self, seconds: float) -> Delivery | None:
        """Return the next new message, None if none arrives within so many seconds."""
        try:
            delivery = self._deliveries.get(timeout=seconds)
        except queue.Empty:
            return None
        if self._carried_out.knows(delivery):
            self.acknowledge(delivery)
            return None
        return delivery

    def acknowledge(self, delivery: Delivery) -> None:
        """Let the broker forget a message; a copy of it is not returned by `next`."""
        self._carried_out.note(delivery)
        with self._lock:
            if delivery.kept and self._is_open and delivery.connection == self._connection:
                self._client.ack(delivery.number, 1)

    def publish(self, message: Message) -> None:
        """Send a message, now or when the broker has returned."""
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties = Properties(PacketTypes.PUBLISH)
        if message.correlation is not None:
            properties.CorrelationData = message.correlation
        self._client.publish(message.topic, message.payload, qos=1, properties=properties)

    def _prepare(self) -> None:
        """Read from files what may have changed since the last connection."""
        self._client.username_pw_set(self._login.user, self._login.read_password())
        if self._context:
            self._login.load_files(self._context)

    def _stay_connected(self) -> None:
        """Connect, and connect again whenever the connection ends."""
        delay = FIRST
        while not self._ending.is_set():
            began = time.monotonic()
            self._cause = ""
            try:
                self._prepare()
                self._connect()
                while not self._client.loop():
                    if self._ending.is_set():
                        self._client.disconnect()
            except RigelK8sError as error:
                self._cause = error.message
            except ssl.SSLCertVerificationError as error:
                self._cause = f"its certificate is not trusted: {error.verify_message}"
            except Exception as error:  # whatever it is, the next attempt may succeed
                self._cause = str(error) or type(error).__name__
            self._close()
            self._report(self._cause or "it has ended")
            if time.monotonic() - began > LONGEST:
                delay = FIRST
            self._ending.wait(delay)
            delay = min(2 * delay, LONGEST)

    def _connect(self) -> None:
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties = Properties(PacketTypes.CONNECT)
        properties.SessionExpiryInterval = KEPT
        properties.ReceiveMaximum = MOST_AT_ONCE
        properties.MaximumPacketSize = MOST_BYTES
        self._client.connect(
            self._address.host,
            self._address.port,
            KEEPALIVE,
            clean_start=False,
            properties=properties,
        )

    def _begin(
        self, client: Client, _data: Any, flags: ConnectFlags, reason: ReasonCode, _: Any
    ) -> None:
        """Subscribe on a new connection: the broker may have lost the session."""
        from paho.mqtt.subscribeoptions import SubscribeOptions

        if reason.is_failure:
            user = (
                f'the user "{self._login.user}"' if self._login.user else "a client without a user"
            )
            self._cause = f"the broker refuses {user}: {reason}"
            return
        with self._lock:
            self._is_open = True
            self._connection += 1
            self._session += not flags.session_present
        # Own answers must not be received, and a retained command is an old one.
        options = SubscribeOptions(
            qos=1, noLocal=True, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND
        )
        client.subscribe([(topic, options) for topic in self._topics])

    def _check_subscription(
        self, client: Client, _data: Any, _mid: int, reasons: list[ReasonCode], _: Any
    ) -> None:
        for topic, reason in zip(self._topics, reasons, strict=False):
            if reason.is_failure:
                self._cause = f"the broker refuses the topic {topic}: {reason}"
                client.disconnect()
                return
        self._reporter.line(f"connected to {self._address}")
        self._troubles.clear()
        self._ready.set()

    def _take(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        if message.qos == 0 and self._deliveries.qsize() >= MOST_WAITING:
            return  # QoS 0 promises nothing; a fast sender must not fill the memory
        properties = message.properties
        arrival = Arrival(
            topic=message.topic,
            payload=bytes(message.payload),
            response_topic=getattr(properties, "ResponseTopic", None),
            correlation=getattr(properties, "CorrelationData", None),
        )
        delivery = Delivery(
            arrival=arrival,
            number=message.mid,
            kept=message.qos > 0,
            again=message.dup,
            connection=self._connection,
            session=self._session,
        )
        self._deliveries.put(delivery)

    def _end(
        self, _client: Client, _data: Any, _flags: DisconnectFlags, reason: ReasonCode, _: Any
    ) -> None:
        self._cause = self._cause or f"it has ended: {reason}"
        self._close()

    def _close(self) -> None:
        with self._lock:
            self._is_open = False
        self._ready.clear()

    def _report(self, trouble: str) -> None:
        """Report once, until it is ready again, why the agent has no connection to its broker."""
        self._trouble = f"no connection to {self._address}: {trouble}"
        if trouble not in self._troubles and not self._ending.is_set():
            self._reporter.warn(f"{self._trouble}; trying again")
            self._troubles.add(trouble)

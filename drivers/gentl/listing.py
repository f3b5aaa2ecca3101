"""The cameras of a GenTL producer, for the list of connected devices."""

from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from drivers.apart import ask_apart
from fpplab.core.extras import how_to_install


@dataclass(frozen=True)
class ListedCamera:
    """A camera, as its producer reports it."""

    serial: str  # serial number, or the producer's own name for it
    vendor: str
    model: str
    layer: str  # transport layer, such as U3V or GEV


def listed_cameras(path: Path) -> list[ListedCamera] | str:
    """Ask a producer for its cameras, in a process of its own: as a library of another maker it may crash."""
    answer: list[ListedCamera] | str | None = ask_apart(send_cameras, path, timeout_s=20.0)
    return "it crashes, or does not answer" if answer is None else answer


def send_cameras(connection: Connection, path: Path) -> None:
    """Send the list of cameras, or the reason why there is none."""
    try:
        from drivers.gentl.producer import GentlProducer, reported_property
    except ImportError as error:
        connection.send(how_to_install(error.name or str(error)))
        return
    try:
        producer = GentlProducer(path)
        cameras = producer.cameras()
    except Exception as error:  # noqa: BLE001 - whatever a producer does, the others are listed
        connection.send(str(error))
        return
    connection.send(
        [
            ListedCamera(serial, *(reported_property(info, key) for key in ("vendor", "model", "tl_type")))
            for serial, info in cameras.items()
        ]
    )
    producer.close()

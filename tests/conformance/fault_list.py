"""All seeded faults."""

from __future__ import annotations

from tests.conformance.display_faults import DISPLAYS, RIG_FILES, TIMING
from tests.conformance.driver_faults import (
    DRIVER_OF_BASLER,
    DRIVER_OF_DLP4500,
    DRIVER_OF_GRBL,
    VIDEO_PORT_OF_DLP4500,
)
from tests.conformance.fault import Fault
from tests.conformance.interface_faults import (
    CAMERA,
    IN_STEP,
    LIFE,
    PROJECTOR,
    SIMULATED,
    STAGE_AND_FIXTURE,
)

FAULTS: list[Fault] = (
    LIFE
    + CAMERA
    + PROJECTOR
    + STAGE_AND_FIXTURE
    + IN_STEP
    + SIMULATED
    + DRIVER_OF_BASLER
    + DRIVER_OF_DLP4500
    + VIDEO_PORT_OF_DLP4500
    + DRIVER_OF_GRBL
    + DISPLAYS
    + TIMING
    + RIG_FILES
)

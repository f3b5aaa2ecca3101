"""All seeded faults."""

from __future__ import annotations

from tests.conformance.basler_faults import DRIVER_OF_BASLER
from tests.conformance.camera_faults import GENTL_AND_VIDEO, NODE_TABLES
from tests.conformance.display_faults import DISPLAYS, RIG_FILES, TIMING
from tests.conformance.dlp4500_faults import DRIVER_OF_DLP4500, VIDEO_PORT_OF_DLP4500
from tests.conformance.fault import Fault
from tests.conformance.grbl_faults import DRIVER_OF_GRBL
from tests.conformance.in_step_faults import IN_STEP, SIMULATED
from tests.conformance.interface_faults import CAMERA, LIFE, PROJECTOR, STAGE_AND_FIXTURE
from tests.conformance.lock_faults import LOCKED
from tests.conformance.timing_faults import CHECKED, STARTED, TIMED

FAULTS: list[Fault] = (
    LIFE
    + CAMERA
    + PROJECTOR
    + STAGE_AND_FIXTURE
    + IN_STEP
    + SIMULATED
    + DRIVER_OF_BASLER
    + NODE_TABLES
    + GENTL_AND_VIDEO
    + DRIVER_OF_DLP4500
    + VIDEO_PORT_OF_DLP4500
    + DRIVER_OF_GRBL
    + TIMED
    + STARTED
    + CHECKED
    + DISPLAYS
    + TIMING
    + RIG_FILES
    + LOCKED
)

"""Every planted fault, room by room."""

from __future__ import annotations

from tests.mutation.faults_of_depth import DEPTH
from tests.mutation.faults_of_drives import DRIVES
from tests.mutation.faults_of_graphs import GRAPHS
from tests.mutation.faults_of_lio import LIO
from tests.mutation.faults_of_localization import LOCALIZATION
from tests.mutation.faults_of_mapping import MAPPING
from tests.mutation.faults_of_metrics import METRICS
from tests.mutation.faults_of_motion import MOTION
from tests.mutation.faults_of_people import PEOPLE
from tests.mutation.faults_of_places import PLACES
from tests.mutation.faults_of_safety import SAFETY
from tests.mutation.faults_of_sensors import SENSORS
from tests.mutation.faults_of_stations import STATIONS
from tests.mutation.faults_of_terrain import TERRAIN
from tests.mutation.planted import PlantedFault

FAULTS: tuple[PlantedFault, ...] = (
    METRICS
    + SENSORS
    + LOCALIZATION
    + MAPPING
    + LIO
    + SAFETY
    + MOTION
    + PLACES
    + DRIVES
    + GRAPHS
    + TERRAIN
    + DEPTH
    + STATIONS
    + PEOPLE
)

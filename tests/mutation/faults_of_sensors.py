"""Faults of the simulation: a world that is too kind makes every measurement in it too good."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

NOISE = ("tests/sim/test_odometry_noise.py",)
SENSED = ("tests/sim/test_sensors.py",)
INERTIAL = ("tests/sim/test_imu_noise.py",)
ULTRASONIC = ("tests/sim/test_ultrasonic.py",)
PHYSICS = ("tests/sim/test_physics.py",)
FAULTS = ("tests/sim/test_faults.py",)
IMPERFECTIONS = ("tests/sim/test_imperfections.py",)
TOLD = ("tests/apps/test_imperfect_robot.py",)
LOGS = ("tests/recordings/test_carmen_scans.py",)

SENSORS = (
    PlantedFault(
        "edges are torn at their later side only",
        "kernels/raycast.py",
        "beside = c - 1 if share < 1.0 else c + 1",
        "beside = c - 1",
        SENSED,
    ),
    PlantedFault(
        "wheels do not slip",
        "sim/odometry.py",
        "noise = spec.slip_sigma * math.sqrt(1.0 - keep * keep)",
        "noise, self._slip = 0.0, 0.0 * self._slip",
        NOISE,
    ),
    PlantedFault(
        "slip keeps its first value for ever",
        "sim/odometry.py",
        "self._slip = keep * self._slip + noise",
        "self._slip = self._slip + 0.0",
        NOISE,
    ),
    PlantedFault(
        "the base knows its track exactly",
        "sim/odometry.py",
        "1.0 + spec.track_sigma *",
        "1.0 + 0.0 *",
        NOISE,
    ),
    PlantedFault(
        "the base knows its wheels' radii exactly",
        "sim/odometry.py",
        "1.0 + spec.radius_sigma *",
        "1.0 + 0.0 *",
        NOISE,
    ),
    PlantedFault(
        "roll and pitch of legs have no noise",
        "sim/odometry.py",
        "roll, pitch = sigma * self._rng.standard_normal(2)",
        "roll, pitch = 0.0 * self._rng.standard_normal(2)",
        NOISE,
    ),
    PlantedFault(
        "the wheels' odometry states a hundredth of its variance",
        "sim/odometry.py",
        "along = (0.02 * self._path) ** 2 + 1e-6",
        "along = (0.002 * self._path) ** 2 + 1e-6",
        NOISE,
    ),
    PlantedFault(
        "the gyroscope has no noise",
        "sim/imu.py",
        "self._white = densities * math.sqrt(spec.rate_hz)",
        "self._white = 0.0 * densities * math.sqrt(spec.rate_hz)",
        INERTIAL,
    ),
    PlantedFault(
        "the IMU is white at one rate only",
        "sim/imu.py",
        "self._white = densities * math.sqrt(spec.rate_hz)",
        "self._white = densities * 10.0",
        INERTIAL,
    ),
    PlantedFault(
        "the IMU has no bias when it is switched on",
        "sim/imu.py",
        "self._bias = sigma * rng.standard_normal(6)",
        "self._bias = 0.0 * sigma * rng.standard_normal(6)",
        INERTIAL,
    ),
    PlantedFault(
        "the bias of the IMU stands still",
        "sim/imu.py",
        "self._bias = self._keep * self._bias + self._drive * chance[:6]",
        "self._bias = self._bias + 0.0 * chance[:6]",
        INERTIAL,
    ),
    PlantedFault(
        "gravity pulls the IMU upwards",
        "sim/imu.py",
        "(ax, ay, az + GRAVITY)",
        "(ax, ay, az - GRAVITY)",
        SENSED,
    ),
    PlantedFault(
        "range noise does not grow with the range",
        "sim/lidar.py",
        "*(spec.sigma_0, spec.sigma_1,",
        "*(spec.sigma_0, 0.0,",
        SENSED,
    ),
    PlantedFault(
        "no beam is lost where it meets a surface at a flat angle",
        "sim/lidar.py",
        "spec.grazing_cosine, spec.grazing_dropout)",
        "spec.grazing_cosine, 0.0)",
        SENSED,
    ),
    PlantedFault(
        "sound has no noise",
        "sim/ultrasonic.py",
        "distance += spec.sigma * noise",
        "distance += 0.0 * noise",
        ULTRASONIC,
    ),
    PlantedFault(
        "no echo is lost",
        "sim/ultrasonic.py",
        "if chance < spec.dropout:",
        "if chance < 0.0:",
        ULTRASONIC,
    ),
    PlantedFault(
        "the base goes on for ever without fresh commands",
        "sim/base.py",
        "wanted = self._command if now_ns - self._command_ns <= self._watchdog_ns else BodyVelocity()",
        "wanted = self._command",
        PHYSICS,
    ),
    PlantedFault(
        "wheels that slip do not slip",
        "sim/faults.py",
        "return SLIP if self.is_on(FaultKind.WHEEL_SLIP, seconds) else 0.0",
        "return 0.0",
        FAULTS,
    ),
    PlantedFault(
        "a silent scanner goes on sending",
        "sim/faults.py",
        "if self._hits(FaultKind.SCANNER_DROPOUT, frame, seconds):\n            return None",
        "if self._hits(FaultKind.SCANNER_DROPOUT, frame, seconds):\n            return message, 0.0",
        FAULTS,
    ),
    PlantedFault(
        "a fault begins at once, whatever its time",
        "sim/faults.py",
        "return self.begin <= seconds < self.end",
        "return seconds < self.end",
        FAULTS,
    ),
    PlantedFault(
        "the camera of a real site sits exactly where it was drawn",
        "sim/imperfections.py",
        "            if mount.kind is SensorKind.CAMERA:",
        "            if mount.kind is SensorKind.CAMERA and not self.camera_place:",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "the camera of a real site looks exactly where it was drawn",
        "sim/imperfections.py",
        "SE3.from_rpy(NOWHERE, *self.camera_turn) @",
        "SE3.from_rpy(NOWHERE, 0.0, 0.0, 0.0) @",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "markers of a real site hang exactly",
        "sim/dock_body.py",
        " @ facing @ SE3.from_rpy(m.place, *m.turn) for m in dock.markers",
        " @ facing for m in dock.markers",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "markers of a real site are printed exactly",
        "sim/imperfections.py",
        "size=marker.size * (1.0 + flaw.size)",
        "size=marker.size",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "a switch that closes deeper closes earlier",
        "sim/battery.py",
        "SE2(-dock.contact)",
        "SE2(dock.contact)",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "the floor of a real site is level",
        "sim/imperfections.py",
        "heights = math.tan(self.tilt[0]) *",
        "heights = 0.0 * math.tan(self.tilt[0]) *",
        IMPERFECTIONS,
    ),
    PlantedFault(
        "the robot of a real site is told where its camera really sits",
        "apps/simulated.py",
        "parts.devices, model, has_map=has_map)",
        "parts.devices, None, has_map=has_map)",
        TOLD,
    ),
    PlantedFault(
        "the robot of a real site is told how its lens really projects",
        "apps/simulated.py",
        "        if camera is None:  # it tells",
        "        if False:  # it tells",
        TOLD,
    ),
    PlantedFault(
        "people do not hide markers in pictures",
        "sim/dock_camera.py",
        "            found += _silhouettes(eye, movers)",
        "            found += []",
        ("tests/sim/test_docks.py",),
    ),
    PlantedFault(
        "poses that are turned by no rotation are believed",
        "drivers/serial_base.py",
        "if not is_rotation or not all",
        "if not all",
        ("tests/drivers/test_serial_base.py::test_odometry_that_is_turned_by_no_rotation_is_dropped",),
    ),
    PlantedFault(
        "what cannot be read ends a connection's thread without a word",
        "drivers/shared_link.py",
        "except Exception as error:",
        "except MemoryError as error:",
        ("tests/drivers/test_serial_base.py::test_whatever_goes_wrong_on_the_line_fails_the_driver",),
    ),
    PlantedFault(
        "a drum above the floor is a wheel",
        "robots/urdf.py",
        "if link.rolls and _reaches(link, floor)]",
        "if link.rolls]",
        ("tests/sim/test_urdf.py",),
    ),
    PlantedFault(
        "casters drive",
        "robots/urdf.py",
        "driven = _driven(wheels)",
        "driven = wheels",
        ("tests/sim/test_urdf.py",),
    ),
    PlantedFault(
        "a scanner's code for no return is a wall",
        "recordings/log_scans.py",
        "        found = find_no_return(ranges)\n",
        "        found = None\n",
        LOGS,
    ),
    PlantedFault(
        "a wall at the end of sight is a code for no return",
        "recordings/no_return.py",
        "_TOP * largest if counts.max() >= _COMMONEST * len(top) else None",
        "_TOP * largest",
        ("tests/recordings/test_no_return.py",),
    ),
    PlantedFault(
        "the range that a parameter tells does not count",
        "wire/carmen.py",
        "else told[line.name]",
        "else math.inf",
        LOGS,
    ),
    PlantedFault(
        "every old scanner covers a half turn",
        "wire/carmen_scanners.py",
        "    known = _KNOWN_STEPS_DEG.get(beams)\n",
        "    known = None\n",
        LOGS,
    ),
    PlantedFault(
        "the limit of a program is a scanner's range",
        "recordings/log_scans.py",
        "if is_exceeded(told, ranges if found is None else ranges[ranges < found]):",
        "if told < 0.0:",
        LOGS,
    ),
)

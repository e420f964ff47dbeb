"""Faults of slopes, of the robots that climb them, of plates with a LiDAR and an IMU, and of drives along routes."""

from __future__ import annotations

from tests.mutation.planted import PlantedFault

SLOPES = ("tests/sim/test_slopes.py",)
PLATES = ("tests/sim/test_rig_errors.py",)
PLACES_3D = ("tests/sim/test_spatial_places.py",)
PURSUIT = ("tests/control/test_route_pursuit.py",)
DRIVE = ("tests/apps/test_drive.py",)

DRIVES = (
    PlantedFault(
        "who walks on legs falls over when pushed",
        "sim/contact_physics.py",
        "ASIDE, STAGGER, CAUGHT, FALLING, CATCH_TIME = 0.2,",
        "ASIDE, STAGGER, CAUGHT, FALLING, CATCH_TIME = 0.0,",
        ("tests/sim/test_crowds.py::test_who_walks_on_legs_puts_a_foot_aside_when_he_is_pushed_over",),
    ),
    PlantedFault(
        "somebody begins where a robot stands",
        "sim/movers.py",
        "for walker in self.walkers if footprints_world else ():",
        "for walker in ():",
        ("tests/sim/test_crowds.py",),
    ),
    PlantedFault(
        "the pattern of a Mid-360 repeats",
        "sim/lidar.py",
        "self._directions = rosette(first, self.spec)",
        "self._directions = rosette(0.0, self.spec)",
        ("tests/sim/test_slopes.py::test_a_pattern_that_does_not_repeat_fills_its_gaps",),
    ),
    PlantedFault(
        "every LiDAR's clock is right",
        "sim/devices.py",
        "stamp_ns = self._world.now_ns - self._sweep_ns - round(self._spec.clock * 1e9)",
        "stamp_ns = self._world.now_ns - self._sweep_ns",
        PLATES,
    ),
    PlantedFault(
        "a LiDAR sits where it is drawn",
        "sim/rig_errors.py",
        "base_from_sensor=mount.base_from_sensor @ flaw.drawn_from_built",
        "base_from_sensor=mount.base_from_sensor",
        PLATES,
    ),
    PlantedFault(
        "counts of an IMU are endlessly fine",
        "sim/imu.py",
        "np.round(values / step) * step, values",
        "values, values",
        PLATES,
    ),
    PlantedFault(
        "an upright trunk leans twice",
        "sim/body.py",
        "SE3().interpolate(tilt.inverse(), self._upright)",
        "SE3().interpolate(tilt, self._upright)",
        SLOPES,
    ),
    PlantedFault(
        "who sits walks",
        "sim/body.py",
        "            self.controller.command(BodyVelocity(), elapsed_ns)",
        "            pass",
        SLOPES,
    ),
    PlantedFault(
        "rays meet people at the height of z = 0",
        "sim/movers.py",
        "rows[:, 2] += ground_under(self._world, rows[:, :2])",
        "rows[:, 2] += 0.0",
        SLOPES,
    ),
    PlantedFault(
        "the cheap mode goes farther up a slope than its wheels turn",
        "sim/kinematic_physics.py",
        "ahead, aside = (1.0, 1.0) if self._world.is_flat else _level_shares(body.carriage)",
        "ahead, aside = (1.0, 1.0)",
        ("tests/sim/test_ground.py",),
    ),
    PlantedFault(
        "the cheap mode climbs kerbs",
        "sim/kinematic_physics.py",
        "name if is_step or is_steep else None",
        "name if is_steep else None",
        ("tests/sim/test_ground.py",),
    ),
    PlantedFault(
        "kerbs count from z = 0",
        "sim/generator/spatial.py",
        "ground - 0.4, ground + KERB[0], yaw",
        "ground - 0.4, KERB[0], yaw",
        PLACES_3D,
    ),
    PlantedFault(
        "a pursuit turns away from its route",
        "control/route_pursuit.py",
        "BodyVelocity(speed * math.cos(angle), 0.0, speed * curvature)",
        "BodyVelocity(speed * math.cos(angle), 0.0, -speed * curvature)",
        PURSUIT,
    ),
    PlantedFault(
        "hills are obstacles for the gate of who is driven",
        "apps/drive.py",
        'replace(scene.config, mapping="ground").gate_for(model)',
        "scene.config.gate",
        ("tests/apps/test_drive.py::test_a_hill_is_no_obstacle",),
    ),
    PlantedFault(
        "the truth of a drive is the base's, not the IMU's",
        "apps/drive.py",
        "[pose @ mount for pose in poses]",
        "[pose for pose in poses]",
        DRIVE,
    ),
    PlantedFault(
        "a robot of a drive is built as it is drawn",
        "apps/drive.py",
        "scene.robot if options.is_perfect else as_built(scene.robot, options.seed)",
        "scene.robot",
        DRIVE,
    ),
)

"""The exception tree. Every failure has a stable code, and one sentence that an operator can act on."""


class AmblerError(Exception):
    """Base of every error that Ambler raises on purpose."""

    code = "AMBLER_ERROR"


class BadInputError(AmblerError):
    """A file, an option or a configuration cannot be used; the command line maps it to exit code 2."""

    code = "BAD_INPUT"


class NotWrittenError(BadInputError):
    """A file cannot be written: the disk is full, may only be read, or is gone."""

    code = "NOT_WRITTEN"


class TransformError(AmblerError):
    """A transform is missing or out of its time range; the text names the missing edge."""

    code = "TRANSFORM_MISSING"


class TransformLoopError(TransformError):
    """A frame would hang under itself; the text names it."""

    code = "TRANSFORM_LOOP"


class StaleInputError(AmblerError):
    """A topic's newest message is older than its declared maximum age."""

    code = "STALE_INPUT"


class StackError(AmblerError):
    """A stack is wired wrongly: an unconnected input, two writers of one topic, an unknown service."""

    code = "STACK_INVALID"


class DeviceError(AmblerError):
    """A device cannot be opened, or is none of the kind that was expected."""

    code = "DEVICE_FAILED"


class PlanningError(AmblerError):
    """No path can be given; subclasses name the reason."""

    code = "PLANNING_FAILED"


class StartOutsideMapError(PlanningError):
    code = "START_OUTSIDE_MAP"


class GoalOutsideMapError(PlanningError):
    code = "GOAL_OUTSIDE_MAP"


class StartOccupiedError(PlanningError):
    code = "START_OCCUPIED"


class NoValidPathError(PlanningError):
    code = "NO_VALID_PATH"


class ControlError(AmblerError):
    """No command can be given; subclasses name the reason."""

    code = "CONTROL_FAILED"


class NoValidControlError(ControlError):
    code = "NO_VALID_CONTROL"


class InvalidPathError(ControlError):
    code = "INVALID_PATH"

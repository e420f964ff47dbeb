"""Named failures of localization."""

from ambler.core.errors import AmblerError


class LocalizationError(AmblerError):
    """The pose in the map cannot be told; subclasses name the reason."""

    code = "LOCALIZATION_FAILED"


class NoPoseError(LocalizationError):
    """Nobody has told the localizer where the robot is."""

    code = "NO_INITIAL_POSE"


class InvalidPoseError(LocalizationError):
    """A pose or covariance that is not finite, or not on the map."""

    code = "INVALID_POSE"

"""Why a file, a voltage sequence or a request was refused, or a backend failed."""

from stressbot_msgs.errors import ErrorCode as ErrorCode
from stressbot_msgs.errors import StressbotError as StressbotError


def as_failure(cause: Exception) -> StressbotError:
    """What went wrong in a backend, as a refusal."""
    if isinstance(cause, StressbotError):
        return cause
    return StressbotError(ErrorCode.BACKEND_FAILURE, "backend", f"it failed ({cause!r}): call reset")

"""When a planner has to end: by the clock, or by the number of its tries."""

from stressbot_planner.planners import Progress, Settings


class Limit:
    """What is allowed by some settings, counted from now on.

    Attributes:
        tries: begun so far; what a try is, each planner says.
    """

    def __init__(self, settings: Settings):
        self._settings, self._begin = settings, settings.clock()
        self.tries = 0

    def __str__(self):
        return f"{self._settings.max_tries} tries" if self._tried_out(1.0) else f"{self._settings.time_limit:g} s"

    def late(self) -> bool:
        """Return whether the time is over."""
        return self._settings.clock() - self._begin > self._settings.time_limit

    def over(self, share: float = 1.0) -> bool:
        """Return whether the tries or the time are used up, or a share: of the tries if they are limited, else of the time."""
        if self._settings.max_tries is not None:
            return self._tried_out(share) or self.late()
        return self._settings.clock() - self._begin > share * self._settings.time_limit

    def another(self) -> bool:
        """Return whether one more try is allowed; count it, and tell who listens."""
        if self.over():
            return False
        self.tries += 1
        if self._settings.on_progress:
            self._settings.on_progress(Progress(self.tries))
        return True

    def _tried_out(self, share: float) -> bool:
        most = self._settings.max_tries
        return most is not None and self.tries >= share * most

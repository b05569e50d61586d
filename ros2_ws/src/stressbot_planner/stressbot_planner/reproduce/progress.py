"""What a person sees meanwhile: bars on a terminal, plain lines elsewhere."""

import time
from typing import TYPE_CHECKING, TextIO

from stressbot_planner.reproduce.runs import Record
from stressbot_planner.reproduce.tables import Table

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Display:
    """Tells sections, runs and tables to a stream."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._bars: Progress | None = None
        self._task: TaskID | None = None
        self._begin = time.monotonic()
        self._done = self._total = self._solved = 0

    def __enter__(self) -> "Display":
        if self._stream.isatty():
            from rich import progress

            self._bars = progress.Progress(
                progress.TextColumn("{task.description}"), progress.BarColumn(), progress.MofNCompleteColumn(),
                progress.TextColumn("{task.fields[latest]}"), progress.TimeElapsedColumn(),
            )
            self._bars.start()
        return self

    def __exit__(self, *_) -> None:
        if self._bars:
            self._bars.stop()

    def section(self, title: str, total: int = 0) -> None:
        """Begin a section; total: its number of runs."""
        self._done, self._total, self._solved = 0, total, 0
        if self._bars:
            self._task = self._bars.add_task(title, total=total, latest="")
        else:
            self.say(f"[{time.monotonic() - self._begin:4.0f} s] {title}" + (f", {total} runs" if total else ""))

    def record(self, record: Record) -> None:
        """Tell that a run has ended."""
        self._done += 1
        self._solved += record["solved"]
        latest = f"{self._solved} solved; {record['planner']} on {record['scenario']}"
        if self._bars and self._task is not None:
            self._bars.update(self._task, completed=self._done, latest=latest)
        elif self._done * 5 // self._total > (self._done - 1) * 5 // self._total:
            self.say(f"[{time.monotonic() - self._begin:4.0f} s]   {self._done} of {self._total} runs, {self._solved} solved")

    def table(self, table: Table) -> None:
        """Show a table."""
        if not self._bars:
            self.say("\n" + table.markdown())
            return
        from rich.table import Table as RichTable
        from rich.text import Text

        shown = RichTable(title=table.title, title_justify="left", caption_justify="left")
        shown.caption = Text(table.note) if table.note else None
        for k, name in enumerate(table.header):
            shown.add_column(name, justify="left" if k == 0 else "right")
        for row in table.rows:
            shown.add_row(*map(Text, row))
        self._bars.console.print(shown)

    def say(self, text: str) -> None:
        """Show a line."""
        if self._bars:
            self._bars.console.print(text, markup=False, highlight=False)
        else:
            self._stream.write(text + "\n")
            self._stream.flush()

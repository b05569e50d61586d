"""What came of a campaign, as a table."""

import numpy as np

from stressbot_planner.reproduce.tables import Table


def table(results: list[dict]) -> Table:
    """One row a fault."""
    rows = []
    for name in dict.fromkeys(outcome["fault"] for outcome in results):
        mine = [outcome for outcome in results if outcome["fault"] == name]
        good = [outcome for outcome in mine if outcome["documented"]]
        zeros = [1e3 * outcome["zero"] for outcome in good if outcome["zero"] is not None]
        told = good[-1] if good else {"seen": mine[0]["error"], "state": "?", "recovered": "?"}
        zero = f"{np.median(zeros):.0f} ({max(zeros):.0f})" if zeros else "–"
        rows.append((name, f"{len(good)}/{len(mine)}", told["seen"].replace("|", "/"), zero, told["state"], told["recovered"]))
    header = ("fault", "documented", "what the user sees", "zero volts (ms): median (max)", "state", "after recovery")
    note = (
        "- Each at random moments of a run. Zero volts: from the fault to the arrival, in another process, of the driver_status "
        "that says so; –: nothing has to stop, or the driver cannot say so.\n"
        "- Where the driver cannot say so, and where it is flooded or deaf, zero volts are those that the substrate saw."
    )
    return Table("Faults", header, tuple(rows), note)

"""`make bench`: prints every table and writes them to results/bench/."""

import argparse
from pathlib import Path

import planners
import speed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each planner on each problem (the paper: 20 and 10)")
    parser.add_argument("--output", type=Path, default=Path("results/bench"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for name, table in (("speed", speed.table), ("planners", lambda: planners.table(args.seeds))):
        text = table()
        (args.output / f"{name}.md").write_text(text + "\n", encoding="utf-8")
        print(f"\n{text}\n", flush=True)
    print(f"written: {args.output}")


if __name__ == "__main__":
    main()

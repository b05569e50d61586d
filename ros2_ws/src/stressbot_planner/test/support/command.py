"""The command-line tool, called in this process."""

from stressbot_planner.cli import tool as cli


def run(capsys, *arguments):
    """Return (exit code, standard output, standard error)."""
    try:
        code = cli.main([str(argument) for argument in arguments])
    except SystemExit as exit:
        code = exit.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err

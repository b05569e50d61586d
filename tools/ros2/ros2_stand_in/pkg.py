"""`ros2 pkg`: executables, prefix."""

import argparse
import os

from ament_index_python import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
    get_packages_with_prefixes,
)

from ros2_stand_in.verbs import argument, verb, verbs


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    added = verbs(family)

    executables = verb(added, "executables", _executables, "Output a list of package specific executables")
    argument(executables, package_completer, "package_name", nargs="?", help="The package name")
    executables.add_argument("--full-path", action="store_true", help="Show full path of each executable")

    prefix = verb(added, "prefix", _prefix, "Output the prefix path of a package")
    argument(prefix, package_completer, "package_name", help="The package name")
    prefix.add_argument("--share", action="store_true", help="Show share directory for the package")


def package_completer(**_):
    """Return the names of all packages."""
    return list(get_packages_with_prefixes())


def executable_paths(package: str) -> list[str]:
    """Return the paths of a package's executables.

    Raises:
        RuntimeError: there is no such package.
    """
    try:
        prefix = get_package_prefix(package)
    except (PackageNotFoundError, ValueError):
        raise RuntimeError(f"Package '{package}' not found") from None
    paths = []
    for folder, folders, files in os.walk(os.path.join(prefix, "lib", package)):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        paths += [os.path.join(folder, name) for name in sorted(files) if os.access(os.path.join(folder, name), os.X_OK)]
    return paths


def _executables(options: argparse.Namespace) -> None:
    for package in [options.package_name] if options.package_name else sorted(get_packages_with_prefixes()):
        for path in sorted(executable_paths(package)):
            print(path if options.full_path else f"{package} {os.path.basename(path)}")


def _prefix(options: argparse.Namespace) -> str | None:
    find = get_package_share_directory if options.share else get_package_prefix
    try:
        print(find(options.package_name))
    except (PackageNotFoundError, ValueError):
        return "Package not found"
    return None

"""``python -m seedslib``: the commands of the book."""

try:
    from seedslib.experiments.cli import main
except ModuleNotFoundError as error:
    raise SystemExit(
        f"seedslib: {error.name} is not installed; the commands want the extra 'book'"
    ) from None

raise SystemExit(main())

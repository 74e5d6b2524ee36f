"""Where the program begins: signals are handled before anything that takes time is imported."""

from __future__ import annotations

from rigel_k8s import signals


def main(*, name: str | None = None) -> None:
    """Run the command line and end the process; `name` as in cli/main.py."""
    signals.handle(signals.leave_early)
    from rigel_k8s.cli.main import main as run

    signals.handle(signals.raise_interrupt)
    run(name=name)

"""What trainings and evaluations there are, how far they are, who made them; and removing them.

python -m tf_lab.runs [list | show NAME... | rm [--dry-run] NAME...] [output=DIR]

A NAME is a directory, its name, or the key at the name's end. With a training go its evaluations;
--dry-run only says what would go.

Examples:
  python -m tf_lab.runs list output=outputs
  python -m tf_lab.runs show NAME
"""

from tf_lab.cli.command import print_anything
from tf_lab.support.stops import stoppable


def main() -> None:
    """List, show or remove."""
    print_anything()
    with stoppable("what was removed is gone, all else is as it was"):
        from tf_lab.commands.runs import run  # takes a second, in which signals are heard

        run(__doc__ or "")


if __name__ == "__main__":
    main()

"""Train (or reuse the identical finished training), evaluate on the test split, print the row.

python -m tf_lab.train [overrides]
"""

from tf_lab.cli.command import command

main = command(
    "train",
    __doc__,
    "tf_lab.commands.train:run",
    keeps="what is finished and the last checkpoint are kept, the same command goes on from them",
    jobs="tf_lab.commands.train:JOBS",
)

if __name__ == "__main__":
    main()

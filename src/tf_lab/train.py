"""Train (or reuse the identical finished training), evaluate on the test split, print the row.

python -m tf_lab.train [overrides]

Examples:
  python -m tf_lab.train fusion=avg seed=1
  python -m tf_lab.train -m views=4,8,16 select=rnd,attn
"""

from tf_lab.cli.command import command

TRAINING_ONLY = tuple(  # of the data that is only tested on
    f"test_on.{name}"
    for name in (
        *("name", "size", "val_size", "frames", "rooms", "furniture", "textures"),
        *("urls", "shuffle", "train", "val"),
    )
)
main = command(
    "train",
    __doc__,
    "tf_lab.commands.train:run",
    unused=TRAINING_ONLY,
    keeps="what is finished and the last checkpoint are kept, the same command goes on from them; "
    "a test begins again",
    jobs="tf_lab.commands.train:JOBS",
)

if __name__ == "__main__":
    main()

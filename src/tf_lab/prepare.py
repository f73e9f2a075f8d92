"""Source data to scenes with ground truth: parallel, restartable, one scene failing alone.

python -m tf_lab.prepare data=NAME data.root=DIR

Examples:
  python -m tf_lab.prepare data=scannet data.root=SCANNET shards=SHARDS
  python -m tf_lab.prepare data=flats data.test_size=12 'splits=[test]'
"""

from tf_lab.cli.command import command

main = command(
    "prepare",
    __doc__,
    "tf_lab.commands.prepare:run",
    unused=("encoder", "optimizer"),
    keeps="what is finished is kept, the same command makes the rest",
)

if __name__ == "__main__":
    main()

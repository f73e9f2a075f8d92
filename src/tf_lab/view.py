"""Watch a reconstruction grow in the browser, or look at a run or at meshes.

python -m tf_lab.view [input=DIR | run=DIR | mesh=FILE] [checkpoint=DIR] [port=N]

Without any it reconstructs a test room. The page is for this machine only; the command prints its
address and how to see it from another.

Examples:
  python -m tf_lab.view input=my_video views=8
  python -m tf_lab.view 'checkpoint=[DIR_A,DIR_B]' port=8090
"""

from tf_lab.cli.command import TRAINING_DATA, command

main = command(
    "view",
    __doc__,
    "tf_lab.commands.view:run",
    unused=TRAINING_DATA,
    keeps="the page is gone, the same command shows it again",
)

if __name__ == "__main__":
    main()

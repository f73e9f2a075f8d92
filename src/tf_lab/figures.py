"""The paper's figures, of a network, a capture, a run or a study, without a display.

python -m tf_lab.figures [figures=[NAME,...]] [input=DIR | run=DIR] [checkpoint=DIR] [output=DIR]

Without any it draws all that it finds something for, of a test room by the shipped checkpoint:
views (which view is best where), selected (the views kept at points), comparison (methods beside
the ground truth), ablations, errors (in cm), room (from above and from inside), fscore_k and
fscore_rows (a study's seeds: mean and deviation), runtimes.

Examples:
  python -m tf_lab.figures 'figures=[views,selected]' input=my_video
  python -m tf_lab.figures 'figures=[fscore_k,fscore_rows]' runs=results/reference/runs
"""

from tf_lab.cli.command import TRAINING_DATA, command

main = command("figures", __doc__, "tf_lab.commands.figures:run", unused=TRAINING_DATA)

if __name__ == "__main__":
    main()

"""Posed images to a mesh, with the shipped checkpoint or one of yours.

python -m tf_lab.reconstruct [input=DIR] [checkpoint=DIR] [output=FILE.ply]

Without an input it reconstructs a test room and prints its score.

Examples:
  python -m tf_lab.reconstruct input=my_video output=room.glb decimate=0.2
  python -m tf_lab.reconstruct input=my_video method=plane_sweep
"""

from tf_lab.cli.command import TRAINING_DATA, command

main = command("reconstruct", __doc__, "tf_lab.commands.reconstruct:run", unused=TRAINING_DATA)

if __name__ == "__main__":
    main()

"""Evaluate meshes in the published layout.

python -m tf_lab.evaluate predictions=DIR groundtruth=DIR [output=FILE.json]

Examples:
  python -m tf_lab.evaluate predictions=meshes groundtruth=SCENES output=scores.json
  python -m tf_lab.evaluate predictions=meshes groundtruth=SCENES 'metrics=[normals]'
"""

from tf_lab.cli.command import command

main = command("evaluate", __doc__, "tf_lab.commands.evaluate:run")

if __name__ == "__main__":
    main()

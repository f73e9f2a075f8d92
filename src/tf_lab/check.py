"""Is a capture what it says it is? Cameras, poses, scale and depth, held against its images.

python -m tf_lab.check input=DIR [output=DIR]

It names the setting that mends what is wrong, for check, reconstruct and prepare. The exit status
is 0 if all is fine, 1 if anything is doubtful, wrong or cannot be told.

Examples:
  python -m tf_lab.check input=my_video
  python -m tf_lab.check input=transforms.json focal_scale=0.9 output=checked
"""

from tf_lab.cli.command import command

main = command("check", __doc__, "tf_lab.commands.check:run")

if __name__ == "__main__":
    main()

"""Train the network that reads depth from the scores of stereo (`inputs=stereo`), on known depth.

python -m tf_lab.pretrain_stereo [data=flats] [output=FILE.safetensors]

Examples:
  python -m tf_lab.pretrain_stereo data.size=16 data.rooms=64
  python -m tf_lab.pretrain_stereo real=DIR trainer.precision=bf16-mixed
"""

from tf_lab.cli.command import command

main = command(
    "pretrain_stereo",
    __doc__,
    "tf_lab.commands.pretrain_stereo:run",
    unused=("trainer.devices", "trainer.strategy", "trainer.compile", "trainer.others"),
    keeps="the scenes and the last checkpoint are kept, the same command goes on from them",
)

if __name__ == "__main__":
    main()

"""Pre-train the encoder on the train split by matching: stand-in for, or finish of, ImageNet.

python -m tf_lab.pretrain model=tiny [encoder=efficientnet_lite0] [output=FILE.safetensors]

Examples:
  python -m tf_lab.pretrain model=tiny data.size=64
  python -m tf_lab.pretrain model=tiny encoder=efficientnet_lite0 output=encoder.safetensors
"""

from dataclasses import fields

from tf_lab.cli.command import command
from tf_lab.config.groups import ModelSettings

main = command(
    "pretrain",
    __doc__,
    "tf_lab.commands.pretrain:run",
    unused=(
        *(f"model.{field.name}" for field in fields(ModelSettings) if field.name != "name"),
        "training",
        "optimizer",
        "trainer.devices",
        "trainer.strategy",
        "trainer.compile",
        "trainer.others",
    ),
    keeps="the scenes and the last checkpoint are kept, the same command goes on from them",
)

if __name__ == "__main__":
    main()

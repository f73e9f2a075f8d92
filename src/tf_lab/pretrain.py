"""Pre-train the encoder on the train split by matching: stand-in for, or finish of, ImageNet.

python -m tf_lab.pretrain model=tiny [encoder=efficientnet_lite0] [output=FILE.safetensors]
"""

from tf_lab.cli.command import command

main = command(
    "pretrain",
    __doc__,
    "tf_lab.commands.pretrain:run",
    unused=(
        "model",
        "training",
        "optimizer",
        "trainer.devices",
        "trainer.strategy",
        "trainer.compile",
        "trainer.others",
    ),
    resumable=True,
)

if __name__ == "__main__":
    main()

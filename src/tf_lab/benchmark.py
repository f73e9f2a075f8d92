"""The paper's runtime tables on this machine, eager beside lazy, and what memory it takes.

python -m tf_lab.benchmark [model=paper|small|tiny] [device=auto|cpu|cuda] [width=640 height=480]

Examples:
  python -m tf_lab.benchmark model=tiny width=160 height=120
  python -m tf_lab.benchmark 'parts=[live]'
"""

from tf_lab.cli.command import command

main = command(
    "benchmark", __doc__, "tf_lab.commands.benchmark:run", unused=("training", "optimizer")
)

if __name__ == "__main__":
    main()

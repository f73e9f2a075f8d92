"""All finished runs as the paper's tables and charts, beside the paper's numbers.

python -m tf_lab.report [runs=DIR] [output=DIR]

Examples:
  python -m tf_lab.report
  python -m tf_lab.report runs=results/reference/runs output=reference pages=false
"""

from tf_lab.cli.command import command

main = command("report", __doc__, "tf_lab.commands.report:run")

if __name__ == "__main__":
    main()

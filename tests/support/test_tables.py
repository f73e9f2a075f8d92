from tf_lab.support.tables import aligned


def test_columns_are_aligned_as_told():
    rows = [["7", "w/o TRSF, avg", "0", "0.123"], ["12", "Ours", "10", "failed: [red]why[/red]"]]
    assert aligned(rows, "rlrl", ["job", "row", "seed", "F-score"]).splitlines() == [
        "job  row            seed  F-score",
        "  7  w/o TRSF, avg     0  0.123",
        " 12  Ours             10  failed: [red]why[/red]",
    ]


def test_the_last_side_goes_on_and_widths_and_rule_are_as_asked():
    text = aligned([["a", "1.00", "22.00"]], head=["", "x", "y"], rule=True, width=3)
    assert text.splitlines() == ["        x      y", "-" * 16, "a    1.00  22.00"]


def test_nothing_is_wrapped_or_cut_however_long_the_line(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setenv("FORCE_COLOR", "1")
    cells = ["x" * 3000, "words " * 500]
    assert aligned([cells], "l") == f"{cells[0]}  {cells[1].rstrip()}"


def test_no_rows_make_no_text():
    assert aligned([], head=[]) == ""

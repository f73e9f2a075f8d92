"""The paper's figures, each drawn of plain data; `catalog` knows all by name."""

from bookkit.text_tables import pieces, to_html

TABLE = """errors on two sensors:
filter          RMS error       wrong modes
Bayes    1.1398 ± 0.0022    0.2943 ± 0.0009
IMM      1.1650 ± 0.0024"""


def test_a_printed_table_is_read_by_its_columns():
    (table,) = pieces(TABLE)
    assert table.caption == "errors on two sensors"
    assert table.rows == [
        ["filter", "RMS error", "wrong modes"],
        ["Bayes", "1.1398 ± 0.0022", "0.2943 ± 0.0009"],
        ["IMM", "1.1650 ± 0.0024", ""],
    ]
    made = to_html(table.rows, table.caption)
    assert "<caption>errors on two sensors</caption>" in made
    assert '<th scope="col">RMS error</th>' in made
    assert '<th scope="row" class="text">IMM</th><td>1.1650 ± 0.0024</td><td></td>' in made


def test_every_line_is_in_one_piece_and_in_order():
    text = f"first\n\n{TABLE}\nA1H: largest difference 3.3\n"
    found = pieces(text)
    told = [line for piece in found for line in piece.lines]
    assert [line for line in told if line.strip()] == [line for line in text.split("\n") if line]


def test_a_cell_never_moves_to_another_column():
    (table,) = pieces("name     a     b\none            2\ntwo    1.5   3\nthree  2.5")
    assert table.rows[1:] == [["one", "", "2"], ["two", "1.5", "3"], ["three", "2.5", ""]]


def test_numbers_that_name_columns_are_a_head():
    (table,) = pieces(
        "damping      1      2      3\n0.20     0.087  0.083  0.070\n0.70     10.43  13.29  8.818"
    )
    assert '<th scope="col">1</th>' in to_html(table.rows)
    (data,) = pieces("Euler    0.1963  0.2360\nKutta    0.1963  0.2361\nEuler 2  0.1963  0.2371")
    assert "<thead>" not in to_html(data.rows)


def test_what_is_no_table_stays_text():
    for text in (
        "one line 1.0   2.0",
        "a sentence of words\nand a second one\nand a third",
        "a  1.5, simulated  2.5\nb  1.6, simulated  2.6\nc  1.7, simulated  2.7",
        # the head does not stand over its columns, so which is which only the text shows
        "l   last l positions   excess\n1    0.2   3.5   7.5\n2    0.3   4.5   8.5",
        "1  2\n3",
    ):
        assert [piece.rows for piece in pieces(text)] == [[]], text


def test_signs_of_html_are_escaped():
    (table,) = pieces("x      exact\na<b    < 1e-9\nc&d    0.5\n")
    assert "a&lt;b" in to_html(table.rows)
    assert "&lt; 1e-9" in to_html(table.rows)

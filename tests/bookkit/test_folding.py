from docutils import nodes
from docutils.utils import new_document

from bookkit import folding
from bookkit.recording import GLUE, MIME


def test_what_record_printed_is_not_shown_and_what_it_glued_stays():
    said = {"data": {MIME: {"values": {"a": 1}}, "text/plain": "a = 1"}}
    glued = {"data": {GLUE + "text/plain": "1"}, "metadata": {"scrapbook": {"name": "a"}}}
    box = {"data": {MIME: {"claims": {}}, "text/html": "<div></div>", "text/plain": "A: open"}}
    text = {"output_type": "stream", "name": "stdout", "text": "b"}
    notebook = {"cells": [{"outputs": [said, glued, box, text]}, {"cell_type": "markdown"}]}
    assert folding.without_records(notebook)["cells"][0]["outputs"] == [glued, box, text]


def folded(tags):
    document = new_document("page")
    cell = nodes.container(classes=["cell", *tags])
    code = nodes.container(nb_element="cell_code_source")
    output = nodes.container(nb_element="cell_code_output")
    output += nodes.literal_block("printed", classes=["output", "stream"])
    output += nodes.image()
    cell += [code, output]
    document += cell
    folding.FoldText(document).run()
    return code, output


def test_printed_text_is_folded_with_the_code_where_the_tag_says_so():
    code, output = folded(["tag_fold-text"])
    assert len(code.children) == 1
    assert len(output.children) == 1
    code, output = folded([])
    assert len(code.children) == 0
    assert len(output.children) == 2

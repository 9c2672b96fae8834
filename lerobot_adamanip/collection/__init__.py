"""Make demonstrations: run experts, record episodes, survive crashes, assemble a dataset."""

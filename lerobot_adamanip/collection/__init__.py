"""Collection of demonstrations: run experts, record episodes, recover from crashes, assemble a dataset."""

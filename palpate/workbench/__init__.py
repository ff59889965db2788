"""The workbench: a local page on a study, to tick effects and see at once what they do."""

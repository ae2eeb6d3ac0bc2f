"""The display in a browser: a small web server that streams pictures to a page and takes its input.

In: messages of pages, untrusted. Out: frames with cameras, a mouse hand and commands; JPEGs and the state of the panel.
"""

"""The live page: simulator, sea, laws, filter and agents in any browser, printed from the package's equations.

It is made by `page.write_page`, or from the command line by `python -m research web-demo`.
"""

"""The live page: simulation, disturbances, controllers, filter and agents in a browser, printed from the equations.

`page.write_page` or the command `python -m research web-demo` writes it.
"""

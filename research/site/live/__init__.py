"""The live page: simulation, disturbances, controllers, filter and agents in a browser, printed from the equations."""

"""S&P, the subsystem for sensing and perception: its performers are the cameras of the cell.

It sees pixels. It knows neither the world database nor a true pose; a camera's driver alone knows how pixels are made.
"""

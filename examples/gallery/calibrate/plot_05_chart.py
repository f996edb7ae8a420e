"""
Draw a chart to photograph
==========================

`matcam chart` writes a page of slanted squares, bars, a sinusoidal star and dots as vectors, and a description of the positions
and brightness of all elements.
"""

import matcam
from matcam.figures.chart import chart_figure

chart = matcam.targets.design_chart(("squares", "bars", "star", "dots"), pixels_across=3000)
drawn = chart_figure(chart)  # drawn.savefig("chart.pdf")
drawn.set_size_inches(4.2, 5.94)

# %%
# The description is JSON: position of each element on the page, mm, and its reflectance.

print(len(chart.elements), "elements;", chart.elements[0])

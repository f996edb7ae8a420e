"""
What can I photograph to know my camera?
========================================

A page of slanted squares, bars, a sinusoidal star and dots, as vectors, with a description that says what stands
where. `matcam chart` writes both.
"""

import matcam
from matcam.figures.chart import chart_figure

chart = matcam.targets.design_chart(("squares", "bars", "star", "dots"), pixels_across=3000)
drawn = chart_figure(chart)  # drawn.savefig("chart.pdf")
drawn.set_size_inches(4.2, 5.94)

# %%
# The description is JSON: each element's place on the page, mm, and its reflectance.

print(len(chart.elements), "elements;", chart.elements[0])

"""
Do the photographs say what the fit says?
=========================================

`reconstruct` explains the pixels of every highlight by one material, one lens and one geometry. Recorded, fitted, and what is
left in standard deviations of the noise: where the model lacks something, a pattern stays. Here none does.
"""

from matcam.figures.reconstruction_page import highlight_figure
from shared_capture import reconstructed

found = reconstructed()  # yours: matcam.reconstruct("shots/")
for picture, chi2 in zip(found.fit.names, found.fit.solution.chi2, strict=True):
    print(f"{picture}: chi² a pixel {chi2:.2f}")
drawn = highlight_figure(found)  # drawn.savefig("highlights.png")

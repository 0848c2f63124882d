"""Figures and pages to look at and to print.

A page is one HTML file that needs nothing else: no network, no other file, no script to be read. Its figures
are SVG, drawn from the plots that the recording has, too. Allan deviations are drawn by matplotlib.
"""

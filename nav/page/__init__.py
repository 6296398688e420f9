"""What the pages of certnav share.

document      one HTML page that loads nothing from anywhere; its tables and pictures
plots         interactive plots; page.js: what they do in the browser
board         interactive plots that are linked in time
thinning      fewer points to draw, without losing extremes
palette       the colours of all
pictures      figures for papers: one style
tables        one table for a page, as CSV and as LaTeX
quantities    figures in words: three digits, a unit, a dash for what is not known
"""

"""What the pages of certnav share.

document      one HTML page that loads nothing from anywhere; its tables and pictures
board         interactive plots, linked in time; page.js: what they do in the browser
pictures      one palette and one style of figures, drawn as SVG
tables        one table for a page, as CSV and as LaTeX
quantities    figures in words: three digits, a unit, a dash for what is not known
"""

"""What the pages of certnav share: one document, one style of pictures, figures in words."""

"""What a host keeps on its disk, so that nothing is lost when its process ends: pages, and who keeps them."""

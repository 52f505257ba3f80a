from gn0.viewer.route_picture import render_route as render_route
from gn0.viewer.route_picture import segment_words as segment_words

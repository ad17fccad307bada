//! What a cell publishes about itself. It commands nothing.

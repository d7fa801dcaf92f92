"""The twin's scene: the life of its objects, and the plant and SceneGraph that follow the estimates."""

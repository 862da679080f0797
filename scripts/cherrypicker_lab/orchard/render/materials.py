"""Blender's materials: what light surfaces send, and the truth in its place."""

SWITCH, LIGHT, TRUTH = "switch", -1e6, 1e6  # a material's value node and what it is set to
PACK = 4.0  # a label is packed above a normal's component, which lies in [-1, 1]


def new_material(bpy, name, light, color_socket):
    """A diffuse surface lit by the sun lamp, plus the sky's light by how far it faces up.

    `color_socket(nodes, links)` builds the albedo and returns its output socket. The material's
    switch turns the light into the truth, see `truth_light`: a change of a value, after which
    Cycles need not read the meshes anew.
    """
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # Blender 5 makes it at once
        material.use_nodes = True
    # the sky's share is written as emission, but no surface is a lamp to draw shadow rays to
    material.cycles.emission_sampling = "NONE"
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    albedo = color_socket(nodes, links)
    normal = nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    axis = nodes.new("ShaderNodeSeparateXYZ")
    links.new(normal, axis.inputs[0])
    up = nodes.new("ShaderNodeMapRange")
    up.inputs["From Min"].default_value = -1.0
    links.new(axis.outputs["Z"], up.inputs["Value"])
    ambient = nodes.new("ShaderNodeMix")
    ambient.data_type = "RGBA"
    links.new(up.outputs["Result"], ambient.inputs["Factor"])
    sockets = [s for s in ambient.inputs if s.type == "RGBA"]
    sockets[0].default_value = (*light.ambient_bottom, 1.0)
    sockets[1].default_value = (*light.ambient_top, 1.0)
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    links.new(albedo, product.inputs[0])
    links.new(next(s for s in ambient.outputs if s.type == "RGBA"), product.inputs[1])
    emission = nodes.new("ShaderNodeEmission")
    links.new(product.outputs[0], emission.inputs["Color"])
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    links.new(albedo, diffuse.inputs["Color"])
    total = nodes.new("ShaderNodeAddShader")
    links.new(emission.outputs[0], total.inputs[0])
    links.new(diffuse.outputs[0], total.inputs[1])
    either = nodes.new("ShaderNodeMixShader")
    links.new(_switch(nodes, links), either.inputs[0])
    links.new(total.outputs[0], either.inputs[1])
    links.new(truth_light(nodes, links), either.inputs[2])
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(either.outputs[0], output.inputs["Surface"])
    return material


def _switch(nodes, links):
    """A socket of 0 (light) or 1 (truth) after the value node named `SWITCH`.

    The depth is added so that the sum is not known before a ray hits: else Cycles would leave the
    other half of the material out, and read all meshes again at each turn of the switch.
    """
    value = nodes.new("ShaderNodeValue")
    value.name = SWITCH
    value.outputs[0].default_value = LIGHT
    total = nodes.new("ShaderNodeMath")
    total.operation = "ADD"
    links.new(nodes.new("ShaderNodeCameraData").outputs["View Z Depth"], total.inputs[0])
    links.new(value.outputs[0], total.inputs[1])
    above = nodes.new("ShaderNodeMath")
    above.operation = "GREATER_THAN"
    above.inputs[1].default_value = 0.0
    links.new(total.outputs[0], above.inputs[0])
    return above.outputs[0]


def truth_light(nodes, links):
    """Light that is the truth: red depth, green and blue normals with class and tree.

    Depth lies along the optical axis, m. Green is the normal's x in the camera plus 2 plus four
    times the class, blue its y plus 2 plus four times the tree. The normal's z follows, since a
    surface that is seen faces the camera.
    """
    depth = nodes.new("ShaderNodeCameraData").outputs["View Z Depth"]
    turn = nodes.new("ShaderNodeVectorTransform")
    turn.vector_type, turn.convert_from, turn.convert_to = "NORMAL", "WORLD", "CAMERA"
    links.new(nodes.new("ShaderNodeNewGeometry").outputs["True Normal"], turn.inputs[0])
    normal = nodes.new("ShaderNodeSeparateXYZ")
    links.new(turn.outputs[0], normal.inputs[0])
    attribute = nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "truth"
    kinds = nodes.new("ShaderNodeSeparateXYZ")
    links.new(attribute.outputs["Vector"], kinds.inputs[0])
    color = nodes.new("ShaderNodeCombineXYZ")
    links.new(depth, color.inputs[0])
    for k, axis in ((1, "X"), (2, "Y")):
        packed = nodes.new("ShaderNodeMath")
        packed.operation = "MULTIPLY_ADD"
        links.new(kinds.outputs["XY"[k - 1]], packed.inputs[0])
        packed.inputs[1].default_value = PACK
        links.new(normal.outputs[axis], packed.inputs[2])
        above = nodes.new("ShaderNodeMath")  # light is never negative
        above.operation = "ADD"
        above.inputs[1].default_value = 2.0
        links.new(packed.outputs[0], above.inputs[0])
        links.new(above.outputs[0], color.inputs[k])
    emission = nodes.new("ShaderNodeEmission")
    links.new(color.outputs[0], emission.inputs["Color"])
    return emission.outputs[0]


def vertex_colors(nodes, _links):
    """Albedo from the mesh's colour attribute."""
    attribute = nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "albedo"
    return attribute.outputs["Color"]


def image_colors(image, interpolation):
    """Albedo from an image by the mesh's uv."""

    def build(nodes, links):
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "uv3"
        texture = nodes.new("ShaderNodeTexImage")
        texture.image, texture.interpolation, texture.extension = image, interpolation, "EXTEND"
        links.new(attribute.outputs["Vector"], texture.inputs["Vector"])
        return texture.outputs["Color"]

    return build


def ground_colors(image, half):
    """Albedo from an image that spans [-half, half] metres in x and y."""

    def build(nodes, links):
        position = nodes.new("ShaderNodeNewGeometry").outputs["Position"]
        mapping = nodes.new("ShaderNodeMapping")
        mapping.inputs["Scale"].default_value = (0.5 / half, 0.5 / half, 0.0)
        mapping.inputs["Location"].default_value = (0.5, 0.5, 0.0)
        links.new(position, mapping.inputs["Vector"])
        texture = nodes.new("ShaderNodeTexImage")
        texture.image, texture.interpolation, texture.extension = image, "Linear", "EXTEND"
        links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
        return texture.outputs["Color"]

    return build

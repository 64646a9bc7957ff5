"""A bag as a viewer resolves a layout in it: topics by type, frames by links, plotted paths by value."""

import math

from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


def read(bag, names):
    """Topic -> (type, messages) of the topics called so, by the official mcap reader."""
    found = {}
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages(topics=names):
                decoded = STORE.deserialize_cdr(message.data, schema.name)
                found.setdefault(channel.topic, (schema.name, []))[1].append(decoded)
    return found


def connected(topics, fixed):
    """Frames that links of /tf and /tf_static join to the fixed one."""
    links = {
        (link.header.frame_id, link.child_frame_id)
        for name in ("/tf", "/tf_static")
        for message in topics.get(name, ("", []))[1]
        for link in message.transforms
    }
    reached = {fixed} if any(fixed in link for link in links) else set()
    while more := {frame for link in links if reached & set(link) for frame in link} - reached:
        reached |= more
    return reached


def value_at(message, path):
    for step in path:
        message = getattr(message, step)
    return message


def unresolved(layout, bag, *, without=()):
    """What a viewer would show blank: one line each. `without`: topics this bag need not have."""
    panels = layout["configById"]
    space = next(panel for name, panel in panels.items() if name.startswith("3D!"))
    plots = [panel for name, panel in panels.items() if name.startswith("Plot!")]
    plotted = [line["value"].split(".") for panel in plots for line in panel["paths"]]
    topics = read(bag, ["/tf", "/tf_static", *space["topics"], *(topic for topic, *_ in plotted)])
    frames = connected(topics, space["followTf"])
    blank = [] if frames else [f"fixed frame {space['followTf']} is in no transform"]
    for topic in set(space["topics"]) - set(without):
        if topic not in topics:
            blank.append(f"{topic} is not in the bag")
            continue
        strange = {message.header.frame_id for message in topics[topic][1]} - frames
        blank += [f"{topic} is in frame {frame}, which nothing connects" for frame in strange]
    for topic, *path in plotted:
        if topic in topics:
            values = [value_at(message, path) for message in topics[topic][1]]
            if not all(isinstance(value, float) and math.isfinite(value) for value in values):
                blank.append(f"{topic}.{'.'.join(path)} is no number")
        elif topic not in without:
            blank.append(f"{topic} is not in the bag")
    return blank

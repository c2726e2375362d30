// SPDX-License-Identifier: Apache-2.0
// metadata.js: a TFLite model with the metadata that tasks-vision asks for: how the numbers of its
// input picture are normalised. The model of @mediapipe/selfie_segmentation has none.
// Source: FlatBuffers' binary format; the schemas of TFLite (schema.fbs: Model, Metadata, Buffer) and
// of its metadata (metadata_schema.fbs: ModelMetadata to NormalizationOptions).
"use strict";

/// A flatbuffer whose objects are laid down in the order in which they are added; offsets point forward,
/// so an object comes before those that it refers to.
class Forward {
    constructor() {
        this.bytes = Buffer.alloc(0);
    }
    /// Adds bytes at a multiple of `align`; returns where.
    add(bytes, align = 4) {
        const at = Math.ceil(this.bytes.length / align) * align;
        this.bytes = Buffer.concat([this.bytes, Buffer.alloc(at - this.bytes.length), bytes]);
        return at;
    }
    /// Adds a table: fields of {size, value} or null, 4 bytes each but those of size 1; returns the
    /// places of its fields.
    table(fields) {
        const vtable = Buffer.alloc(4 + 2 * fields.length);
        let size = 4;
        const inside = fields.map((f) => (f ? (size += 4) - 4 : 0));
        vtable.writeUInt16LE(vtable.length, 0);
        vtable.writeUInt16LE(size, 2);
        inside.forEach((x, i) => vtable.writeUInt16LE(x, 4 + 2 * i));
        const above = this.add(vtable), table = Buffer.alloc(size);
        const at = this.add(table);
        this.bytes.writeInt32LE(at - above, at);
        fields.forEach((f, i) => {
            if (f && f.size === 1) this.bytes.writeUInt8(f.value, at + inside[i]);
            else if (f) this.bytes.writeUInt32LE(f.value, at + inside[i]);
        });
        return { at, field: inside.map((x) => at + x) };
    }
    /// Adds a vector of `count` numbers or offsets of 4 bytes; returns its place and those of its items.
    vector(count) {
        const bytes = Buffer.alloc(4 + 4 * count);
        bytes.writeUInt32LE(count, 0);
        const at = this.add(bytes);
        return { at, item: Array.from({ length: count }, (_, i) => at + 4 + 4 * i) };
    }
    text(string) {
        const bytes = Buffer.alloc(4 + string.length + 1);
        bytes.writeUInt32LE(string.length, 0);
        bytes.write(string, 4, "latin1");
        return this.add(bytes);
    }
    /// Lets the offset at a place point to an object.
    point(place, to) {
        this.bytes.writeUInt32LE(to - place, place);
    }
}

const number = (value) => ({ value }), offset = number(0), kind = (value) => ({ size: 1, value });

/// Metadata of one input picture, RGB, whose values x of 0 to 255 become (x - mean) / std, and of one
/// output.
function pictureMetadata(mean, std) {
    const f = new Forward();
    f.add(Buffer.from("\0\0\0\0M001", "latin1"));
    const model = f.table([offset, null, null, offset]);
    f.point(0, model.at);
    f.point(model.field[0], f.text("picture"));
    const graphs = f.vector(1);
    f.point(model.field[3], graphs.at);
    const graph = f.table([null, null, offset, offset]);
    f.point(graphs.item[0], graph.at);
    const inputs = f.vector(1), outputs = f.vector(1);
    f.point(graph.field[2], inputs.at);
    f.point(graph.field[3], outputs.at);
    const input = f.table([offset, null, null, offset, offset]);
    f.point(inputs.item[0], input.at);
    f.point(input.field[0], f.text("input"));
    const content = f.table([kind(2), offset]); // ImageProperties
    f.point(input.field[3], content.at);
    f.point(content.field[1], f.table([kind(1)]).at); // RGB
    const units = f.vector(1);
    f.point(input.field[4], units.at);
    const unit = f.table([kind(1), offset]); // NormalizationOptions
    f.point(units.item[0], unit.at);
    const normalization = f.table([offset, offset]);
    f.point(unit.field[1], normalization.at);
    [mean, std].forEach((x, i) => {
        const list = f.vector(1);
        f.point(normalization.field[i], list.at);
        f.bytes.writeFloatLE(x, list.item[0]);
    });
    const output = f.table([offset]);
    f.point(outputs.item[0], output.at);
    f.point(output.field[0], f.text("output"));
    return f.bytes;
}

/// Returns the model with this metadata. Its old bytes follow a new root, so that their offsets, which
/// are relative, stay true; fields of the old root are pointed to where they are now.
function withMetadata(model, metadata) {
    if (model.toString("latin1", 4, 8) !== "TFL3") throw new Error("no TFLite model");
    const root = model.readUInt32LE(0), vtable = root - model.readInt32LE(root);
    const place = (i) => {
        const inside = 4 + 2 * i < model.readUInt16LE(vtable) ? model.readUInt16LE(vtable + 4 + 2 * i) : 0;
        return inside ? root + inside : 0;
    };
    const target = (i) => (place(i) ? place(i) + model.readUInt32LE(place(i)) : 0);
    const [version, operators, graphs, description, buffers] = [0, 1, 2, 3, 4];
    const old = target(buffers), count = model.readUInt32LE(old);
    const f = new Forward();
    f.add(Buffer.from("\0\0\0\0TFL3", "latin1"));
    const table = f.table([number(model.readUInt32LE(place(version))), offset, offset,
                           target(description) ? offset : null, offset, null, offset]);
    f.point(0, table.at);
    const all = f.vector(count + 1), list = f.vector(1);
    f.point(table.field[buffers], all.at);
    f.point(table.field[6], list.at);
    const entry = f.table([offset, number(count)]);
    f.point(list.item[0], entry.at);
    f.point(entry.field[0], f.text("TFLITE_METADATA"));
    const buffer = f.table([offset]);
    f.point(all.item[count], buffer.at);
    const data = Buffer.alloc(4);
    data.writeUInt32LE(metadata.length, 0);
    while ((f.bytes.length + 4) % 16 !== 0) f.add(Buffer.alloc(4));
    f.point(buffer.field[0], f.add(Buffer.concat([data, metadata])));
    const begin = f.add(model, 64);
    for (const i of [operators, graphs, description])
        if (target(i)) f.point(table.field[i], begin + target(i));
    for (let i = 0; i < count; ++i) {
        const item = old + 4 + 4 * i;
        f.point(all.item[i], begin + item + model.readUInt32LE(item));
    }
    return f.bytes;
}

module.exports = { pictureMetadata, withMetadata };

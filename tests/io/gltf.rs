//! Meshes from glTF files: what an OBJ of the same mesh is, and errors that name the place.

use super::{GRID, waving};
use fnopt::cloth::Embedding;
use fnopt::io::{Format, Mesh, MeshFile, RenderMesh, read_mesh};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// A file in the making: its description and its one buffer.
pub(super) struct Maker {
    pub document: Value,
    pub bytes: Vec<u8>,
}

impl Maker {
    /// Begins a file with one mesh of one primitive.
    pub fn new() -> Self {
        let document = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {}}]}], "accessors": [], "bufferViews": [], "buffers": [],
        });
        Self { document, bytes: Vec::new() }
    }

    /// Begins a file with a triangle.
    pub fn triangle() -> Self {
        let mut maker = Self::new();
        maker.attribute("POSITION", "VEC3", &[[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].concat());
        maker.attribute("TEXCOORD_0", "VEC2", &[0.0f32, 1.0, 0.5, 1.0, 0.0, 0.25]);
        maker.indices(&[0u16, 1, 2]);
        maker
    }

    /// Adds an attribute to the first primitive.
    pub fn attribute<T: Number>(&mut self, name: &str, kind: &str, numbers: &[T]) -> &mut Value {
        let accessor = self.accessor(kind, numbers);
        self.primitive()["attributes"][name] = accessor.into();
        &mut self.document["accessors"][accessor]
    }

    /// Adds indices to the first primitive.
    pub fn indices<T: Number>(&mut self, numbers: &[T]) {
        let accessor = self.accessor("SCALAR", numbers);
        self.primitive()["indices"] = accessor.into();
    }

    pub fn primitive(&mut self) -> &mut Value {
        &mut self.document["meshes"][0]["primitives"][0]
    }

    /// Adds an accessor and returns its number.
    pub fn accessor<T: Number>(&mut self, kind: &str, numbers: &[T]) -> usize {
        let view = self.view(numbers);
        let width = ["SCALAR", "VEC2", "VEC3"].iter().position(|&k| k == kind).unwrap() + 1;
        let many = numbers.len() / width;
        push(
            &mut self.document["accessors"],
            json!({"bufferView": view, "componentType": T::CODE, "count": many, "type": kind}),
        )
    }

    /// Adds a view of numbers, one after another, and returns its number.
    pub fn view<T: Number>(&mut self, numbers: &[T]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let from = self.bytes.len();
        numbers.iter().for_each(|number| self.bytes.extend(number.bytes()));
        let view = json!({"buffer": 0, "byteOffset": from, "byteLength": self.bytes.len() - from});
        push(&mut self.document["bufferViews"], view)
    }

    /// Returns the file with its buffer in the description.
    pub fn text(&self) -> String {
        let uri = format!("data:application/octet-stream;base64,{}", base64(&self.bytes));
        self.with_uri(&uri)
    }

    /// Returns the file with its buffer elsewhere.
    pub fn with_uri(&self, uri: &str) -> String {
        let mut document = self.document.clone();
        document["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": uri}]);
        document.to_string()
    }

    /// Returns the binary file.
    pub fn binary(&self) -> Vec<u8> {
        let mut document = self.document.clone();
        document["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = self.bytes.clone();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        let word = |number: usize| (number as u32).to_le_bytes();
        let head =
            [b"glTF".to_vec(), word(2).to_vec(), word(28 + text.len() + bytes.len()).to_vec()].concat();
        let text = [&word(text.len()), &b"JSON"[..], &text].concat();
        [head, text, [&word(bytes.len()), &b"BIN\0"[..], &bytes].concat()].concat()
    }
}

/// A number of a buffer.
pub(super) trait Number {
    const CODE: u32;
    fn bytes(&self) -> Vec<u8>;
}

macro_rules! numbers {
    ($($of:ty: $code:expr),*) => {$(
        impl Number for $of {
            const CODE: u32 = $code;
            fn bytes(&self) -> Vec<u8> {
                self.to_le_bytes().to_vec()
            }
        }
    )*};
}
numbers!(i8: 5120, u8: 5121, i16: 5122, u16: 5123, u32: 5125, f32: 5126);

fn push(list: &mut Value, item: Value) -> usize {
    let list = list.as_array_mut().unwrap();
    list.push(item);
    list.len() - 1
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let group = |group: &[u8]| {
        let bits =
            group.iter().fold(0u32, |bits, &byte| bits << 8 | u32::from(byte)) << (8 * (3 - group.len()));
        let digit =
            |k: usize| if k <= group.len() { DIGITS[(bits >> (18 - 6 * k) & 63) as usize] } else { b'=' };
        String::from_utf8([0, 1, 2, 3].map(digit).to_vec()).unwrap()
    };
    bytes.chunks(3).map(group).collect()
}

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> std::path::PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// Reads a description with its data.
fn read(text: impl AsRef<[u8]>) -> fnopt::Result<Mesh> {
    let folder = tempfile::tempdir().unwrap();
    read_mesh(write(folder.path(), "mesh.gltf", text))
}

/// A square of two quads and a seam between them, and the same as programs write it in glTF: triangles, a vertex for each
/// texture coordinate, v downwards.
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n\
    vt 0 0\nvt .5 .1\nvt .5 .9\nvt 0 1\nvt 0.75 0\nvt 1 0\nvt 1 1\nvt 0.75 1\nf 1/1 2/2 3/3 4/4\nf 2/5 5/6 6/7 3/8\n";
const POSITIONS: [[f32; 3]; 8] = [
    [1.0, 1.0, 0.0],
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [2.0, 1.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [2.0, 0.0, 0.0],
];
const UV: [[f32; 2]; 8] =
    [[0.5, 0.1], [0.0, 1.0], [0.5, 0.9], [0.0, 0.0], [1.0, 0.0], [0.75, 1.0], [0.75, 0.0], [1.0, 1.0]];
const INDICES: [u8; 12] = [1, 2, 0, 1, 0, 3, 5, 7, 4, 5, 4, 6];

/// Returns the corners of a mesh's triangles: where they are in the file, and where on a cloth.
fn corners(mesh: &RenderMesh) -> Vec<[[f32; 6]; 3]> {
    let embedding = Embedding::new(GRID, None, mesh.topology().uv(), "a test").unwrap();
    let carried = embedding.positions(waving(GRID, 2).frame(1));
    let corner = |k: u32| -> [f32; 6] {
        let all = [mesh.positions()[k as usize], carried[k as usize]].concat();
        all.try_into().unwrap()
    };
    mesh.topology().triangles().map(|face| face.map(corner)).collect()
}

fn are_same(one: &RenderMesh, other: &RenderMesh) {
    let (one, other) = (corners(one), corners(other));
    assert_eq!(one.len(), other.len());
    for (a, b) in one.as_flattened().as_flattened().iter().zip(other.as_flattened().as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{one:?}\n{other:?}");
    }
}

#[test]
fn a_mesh_is_placed_as_the_same_obj_is() {
    let folder = tempfile::tempdir().unwrap();
    let obj = RenderMesh::read(write(folder.path(), "mesh.obj", OBJ)).unwrap();
    let mut floats = Maker::new();
    floats.attribute("POSITION", "VEC3", &POSITIONS.concat());
    floats.attribute("NORMAL", "VEC3", &[[0.0f32, 0.0, 1.0]; 8].concat());
    floats.attribute("TEXCOORD_0", "VEC2", &UV.concat());
    floats.indices(&INDICES);
    let files = [
        write(folder.path(), "mesh.glb", floats.binary()),
        write(folder.path(), "data.gltf", floats.text()),
        write(folder.path(), "beside.gltf", floats.with_uri("a%20buffer.bin")),
    ];
    write(folder.path(), "a buffer.bin", &floats.bytes);
    for file in files {
        let mesh = RenderMesh::read(&file).unwrap();
        assert_eq!((mesh.topology().vertices(), mesh.sources()), (8, &[0, 1, 2, 3, 4, 5, 6, 7][..]));
        are_same(&mesh, &obj);
    }
    // In 16 bits, of which 0.1 needs more than 8; without indices.
    let mut words = Maker::new();
    let each = |of: &dyn Fn(usize) -> Vec<u16>| -> Vec<u16> {
        INDICES.iter().flat_map(|&k| of(k as usize)).collect()
    };
    words.attribute("POSITION", "VEC3", &INDICES.map(|k| POSITIONS[k as usize]).concat());
    let uv = each(&|k| UV[k].map(|c| (c * 65535.0).round() as u16).to_vec());
    words.attribute("TEXCOORD_0", "VEC2", &uv)["normalized"] = true.into();
    let mesh = RenderMesh::read(write(folder.path(), "words.glb", words.binary())).unwrap();
    assert_eq!(mesh.topology().vertices(), 12);
    for (a, b) in corners(&mesh).as_flattened().iter().zip(corners(&obj).as_flattened()) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-5), "{a:?} {b:?}");
    }
}

#[test]
fn what_is_written_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let clip = waving(GRID, 3);
    let glb = RenderMesh::read(clip.write(folder.path(), "cloth", Format::Glb).unwrap()).unwrap();
    let obj = clip.write(folder.path(), "cloth", Format::Obj).unwrap().join("00000.obj");
    let obj = RenderMesh::read(obj).unwrap();
    assert_eq!((glb.positions(), glb.sources()), (clip.frame(0), obj.sources()));
    assert!(glb.topology().triangles().eq(obj.topology().triangles()));
    are_same(&glb, &obj);
}

#[test]
fn triangles_of_every_mode() {
    let mut maker = Maker::new();
    maker.attribute("POSITION", "VEC3", &[[0.0f32, 0.0, 0.0]; 6].concat());
    maker.indices(&[0u32, 1, 2, 3, 3, 4]);
    let faces = |mode: u32, maker: &mut Maker| {
        maker.primitive()["mode"] = mode.into();
        read(maker.text()).map(|mesh| mesh.faces).map_err(|e| e.to_string())
    };
    assert_eq!(faces(4, &mut maker).unwrap(), [[0, 1, 2], [3, 3, 4]]);
    assert_eq!(faces(5, &mut maker).unwrap(), [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(faces(6, &mut maker).unwrap(), [[0, 1, 2], [0, 2, 3], [0, 3, 3], [0, 3, 4]]);
    assert!(faces(1, &mut maker).unwrap_err().contains("meshes: expected at least one triangle"));
    assert!(
        faces(7, &mut maker)
            .unwrap_err()
            .contains("meshes[0].primitives[0]: expected a \"mode\" from 0 to 6")
    );
    maker.primitive().as_object_mut().unwrap().remove("indices");
    assert_eq!(faces(4, &mut maker).unwrap(), [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn nodes_place_their_meshes() {
    let mut maker = Maker::triangle();
    let half = 0.5f64.sqrt();
    // A quarter turn around z, then twice as large, then moved; below it the mesh mirrored in x, and a skin.
    let turned = json!({"translation": [1, 2, 3], "rotation": [0, 0, half, half], "scale": [2, 2, 2], "children": [1, 2]});
    let mirrored = json!({"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0.5, 1]});
    maker.document["nodes"] = json!([turned, mirrored, {"mesh": 0, "skin": 0}, {"mesh": 0}]);
    let mesh = read(maker.text()).unwrap();
    let expected =
        [[1.0, 2.0, 4.0], [1.0, 0.0, 4.0], [-1.0, 2.0, 4.0], [0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    for (a, b) in mesh.positions.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{:?}", mesh.positions);
    }
    assert_eq!(mesh.faces, [[0, 2, 1], [3, 4, 5]]);
    // Without a scene all nodes are there, and without nodes all meshes.
    maker.document.as_object_mut().unwrap().remove("scenes");
    maker.document.as_object_mut().unwrap().remove("scene");
    assert_eq!(read(maker.text()).unwrap().faces.len(), 3);
    maker.document.as_object_mut().unwrap().remove("nodes");
    assert_eq!(read(maker.text()).unwrap().positions[1], [1.0, 0.0, 0.0]);
}

/// A node with those below it, or a mesh, by its name.
#[test]
fn an_object_is_read_alone() {
    let mut maker = Maker::triangle();
    let first = maker.document["meshes"][0].clone();
    maker.document["meshes"] = json!([first, first]);
    maker.document["meshes"][1]["name"] = "table".into();
    maker.document["scenes"] = json!([{"nodes": [0, 1]}]);
    maker.document["nodes"] = json!([
        {"mesh": 0, "name": "room", "translation": [1, 0, 0], "children": [2]},
        {"mesh": 1, "name": "other", "translation": [0, 0, 3]},
        {"mesh": 1, "name": "under", "translation": [0, 2, 0]},
    ]);
    let folder = tempfile::tempdir().unwrap();
    let path = write(folder.path(), "room.gltf", maker.text());
    let firsts = |object: Option<&str>| {
        let file = MeshFile { path: path.clone(), object: object.map(str::to_owned) };
        read_mesh(file)
            .map(|mesh| mesh.positions.chunks_exact(3).map(|corners| corners[0]).collect::<Vec<_>>())
    };
    let [room, under, other] = [[1.0f32, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 3.0]];
    for (object, expected) in [
        (None, vec![room, under, other]),
        (Some("room"), vec![room, under]),
        (Some("under"), vec![under]),
        (Some("table"), vec![under, other]),
    ] {
        assert_eq!(firsts(object).unwrap(), expected, "{object:?}");
    }
    let error = firsts(Some("tables")).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "unknown object with a mesh 'tables' (did you mean table? others: other, under, room)"
        ),
        "{error}"
    );
    let file = MeshFile { path: path.clone(), object: Some("under".into()) };
    assert_eq!(file.to_string(), format!("{}: under", path.display()));
    assert_eq!(RenderMesh::read(file).unwrap().topology().vertices(), 3);
    // A file without nodes has its meshes.
    for field in ["nodes", "scenes", "scene"] {
        maker.document.as_object_mut().unwrap().remove(field);
    }
    write(folder.path(), "room.gltf", maker.text());
    assert_eq!(firsts(Some("table")).unwrap(), [[0.0; 3]]);
    assert!(firsts(Some("room")).is_err());
}

#[test]
fn numbers_of_every_type() {
    // Positions in normalised bytes with a distance of four bytes between them, as KHR_mesh_quantization has them.
    let mut maker = Maker::new();
    maker.attribute("POSITION", "VEC3", &[0i8, 0, 0, 9, 127, 0, 0, 9, 0, -128, 0, 9]);
    maker.document["accessors"][0]["normalized"] = true.into();
    maker.document["accessors"][0]["count"] = 3.into();
    maker.document["bufferViews"][0]["byteStride"] = 4.into();
    assert_eq!(read(maker.text()).unwrap().positions, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]);
    // The second and third position are others.
    let mut maker = Maker::triangle();
    let (at, values) = (maker.view(&[1u16, 2]), maker.view(&[[5.0f32, 0.0, 0.0], [0.0, 6.0, 0.0]].concat()));
    let indices = json!({"bufferView": at, "componentType": 5123});
    let sparse = json!({"count": 2, "indices": indices, "values": {"bufferView": values}});
    maker.document["accessors"][0]["sparse"] = sparse;
    let expected = [[0.0; 3], [5.0, 0.0, 0.0], [0.0, 6.0, 0.0]];
    assert_eq!(read(maker.text()).unwrap().positions, expected);
    // All others are zero.
    maker.document["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    assert_eq!(read(maker.text()).unwrap().positions, expected);
    let sparse = &mut maker.document["accessors"][0]["sparse"];
    sparse["indices"]["byteOffset"] = 2.into();
    let error = read(maker.text()).unwrap_err().to_string();
    assert!(error.contains("accessors[0].sparse.indices: expected at most 1 elements"), "{error}");
}

#[test]
fn what_is_no_mesh_with_uvs_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |change: &dyn Fn(&mut Maker), parts: &[&str]| {
        let mut maker = Maker::triangle();
        change(&mut maker);
        let path = write(folder.path(), "mesh.gltf", maker.text());
        let error = RenderMesh::read(path).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    };
    let accessor = |k: usize, field: &'static str, value: Value| {
        move |maker: &mut Maker| maker.document["accessors"][k][field] = value.clone()
    };
    let document =
        |field: &'static str, value: Value| move |maker: &mut Maker| maker.document[field] = value.clone();
    refused(
        &|maker| drop(maker.primitive()["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0")),
        &["mesh.gltf: meshes: expected texture coordinates (TEXCOORD_0)", "found a mesh without UVs"],
    );
    refused(
        &|maker| {
            let mut other = maker.primitive().clone();
            other["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
            push(&mut maker.document["meshes"][0]["primitives"], other);
        },
        &["meshes[0].primitives[1], vertex 0: expected finite texture coordinates", "found none"],
    );
    refused(
        &|maker| {
            maker.attribute("TEXCOORD_0", "VEC2", &[0.0f32, 0.0, 0.0, 0.0, 0.5, 1.25]);
        },
        &["meshes[0].primitives[0], vertex 2: ", "from 0 to 1", "found uv [0.5, 1.25]"],
    );
    refused(
        &|maker| {
            maker.attribute("TEXCOORD_0", "VEC2", &[0.0f32, 0.0]);
        },
        &["attributes.TEXCOORD_0: expected as many elements as POSITION has, 3, found 1"],
    );
    refused(
        &|maker| maker.indices(&[0u8, 1, 3]),
        &["accessors[3], element 2: expected the number of a vertex, below 3, found 3"],
    );
    refused(&|maker| maker.indices(&[0u8, 1]), &["primitives[0]: expected three corners", "found 2 corners"]);
    refused(
        &|maker| maker.indices(&[0i8, 1, 2]),
        &["accessors[3].componentType: expected 5121, 5123 or 5125"],
    );
    refused(
        &|maker| maker.primitive()["indices"] = 9.into(),
        &["primitives[0].indices: expected one of the 3 accessors"],
    );
    refused(&accessor(0, "count", json!(4)), &["accessors[0]: expected at most 3 elements", "found 4"]);
    refused(&accessor(0, "count", json!(u64::MAX)), &["accessors[0]: expected at most 3 elements"]);
    refused(&accessor(0, "byteOffset", json!(u64::MAX)), &["accessors[0]: expected at most 0 elements"]);
    refused(
        &accessor(0, "type", json!("VEC2")),
        &["accessors[0].type: expected \"type\": \"VEC3\", found \"VEC2\""],
    );
    refused(
        &accessor(0, "componentType", json!(5124)),
        &["accessors[0].componentType: expected 5120 to 5123"],
    );
    refused(
        &|maker| maker.document["bufferViews"][1]["byteLength"] = json!(u64::MAX),
        &[
            "bufferViews[1]: expected a part of the buffer's 66 bytes, found 18446744073709551615 bytes from 36 on",
        ],
    );
    refused(
        &|maker| maker.document["bufferViews"][1]["byteStride"] = 4.into(),
        &["bufferViews[1].byteStride: expected 8"],
    );
    refused(
        &|maker| {
            maker.attribute("POSITION", "VEC3", &[[0.0, f32::NAN, 0.0]; 3].concat());
        },
        &["attributes.POSITION, element 0: expected finite numbers"],
    );
    refused(
        &document("nodes", json!([{"mesh": 0, "children": [0]}])),
        &["nodes[0]: expected a node of one parent"],
    );
    refused(
        &document("nodes", json!([{"mesh": 0, "children": [1]}])),
        &["nodes[0].children[0]: expected one of 1 nodes"],
    );
    refused(&document("nodes", json!([{"mesh": 1}])), &["nodes[0].mesh: expected one of the 1 meshes"]);
    refused(&document("asset", json!({"version": "1.0"})), &["asset.version: expected version 2 of glTF"]);
    for (name, expected) in [("KHR_draco_mesh_compression", "Draco"), ("EXT_meshopt_compression", "meshopt")]
    {
        refused(&document("extensionsRequired", json!([name])), &["extensionsRequired[0]", expected, name]);
    }
}

/// A count alone does not make anything large.
#[test]
fn counts_without_bytes_are_refused() {
    let mut maker = Maker::triangle();
    maker.primitive().as_object_mut().unwrap().remove("indices");
    maker.document["accessors"][0] = json!({"componentType": 5126, "count": 1u64 << 40, "type": "VEC3"});
    let error = read(maker.text()).unwrap_err().to_string();
    assert!(error.contains("accessors[0].count: expected a \"bufferView\", or at most"), "{error}");
    // Few bytes, many times.
    let mut maker = Maker::triangle();
    maker.accessor("VEC3", &[0.0f32; 30_000]);
    maker.primitive()["attributes"] = json!({"POSITION": 3});
    maker.document["nodes"] = vec![json!({"mesh": 0}); 2000].into();
    maker.document["scenes"] = json!([{"nodes": (0..2000).collect::<Vec<_>>()}]);
    let error = read(maker.text()).unwrap_err().to_string();
    assert!(error.contains("nodes: expected at most 16777216 vertices"), "{error}");
}

#[test]
fn buffers_are_in_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let below = folder.path().join("below");
    fs::create_dir(&below).unwrap();
    write(folder.path(), "outside.bin", [0; 100]);
    write(&below, "short.bin", [0; 10]);
    let outside = folder.path().join("outside.bin").display().to_string();
    for (uri, parts) in [
        ("absent.bin", &["absent.bin", "cannot read"][..]),
        (
            "../outside.bin",
            &["buffers[0].uri: expected a data URI, or a file in the same folder", "../outside.bin"],
        ),
        (&outside, &["buffers[0].uri: expected a data URI, or a file in the same folder"]),
        ("%2e%2e/outside.bin", &["buffers[0].uri: expected"]),
        ("https://example.com/a.bin", &["buffers[0].uri: expected"]),
        ("", &["buffers[0].uri: expected"]),
        ("data:application/octet-stream;base64,A", &["buffers[0].uri: expected data in base64"]),
        ("data:text/plain,abc", &["buffers[0].uri: expected data in base64"]),
        ("short.bin", &["buffers[0].byteLength: expected at most 10, the bytes that there are, found 66"]),
    ] {
        let path = write(&below, "mesh.gltf", Maker::triangle().with_uri(uri));
        let error = read_mesh(path).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{uri}: {error}");
    }
}

#[test]
fn binary_files_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let whole = Maker::triangle().binary();
    let refused = |bytes: &[u8], parts: &[&str]| {
        let error = read_mesh(write(folder.path(), "mesh.glb", bytes)).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    };
    assert!(read_mesh(write(folder.path(), "mesh.glb", &whole)).is_ok());
    for len in 0..whole.len() {
        refused(&whole[..len], &["mesh.glb: header: expected"]);
    }
    refused(b"{}", &["header: expected binary glTF, which begins with 'glTF', found {}"]);
    let changed = |at: usize, byte: u8| {
        let mut bytes = whole.clone();
        bytes[at] = byte;
        bytes
    };
    refused(&changed(4, 1), &["header: expected version 2 of glTF, found 1"]);
    refused(&changed(15, 255), &["chunk 0: expected at most"]);
    refused(&changed(16, b'X'), &["chunk 0: expected 'JSON', the description, found 'XSON'"]);
    refused(&changed(20, b'x'), &["line 1, column 1: expected JSON"]);
    let mut without = whole.clone();
    let kind = without.windows(4).position(|w| w == b"BIN\0").unwrap();
    without[kind] = b'X';
    refused(&without, &["buffers[0]: expected a \"uri\""]);
}

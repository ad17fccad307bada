//! The reader of meshes of the page, run by node.

use super::page_cell::prints;

/// Makes files, and prints what a reading gives.
const MAKE: &str = r#"
    const { readStl, pieces, BYTES_MAX, TRIANGLES_MAX } = await import("PAGE/js/stl.js");
    const binary = (corners, head = "", count = corners.length / 9) => {
      const bytes = new ArrayBuffer(84 + 50 * Math.floor(corners.length / 9)), view = new DataView(bytes);
      [...head].forEach((letter, at) => view.setUint8(at, letter.charCodeAt(0)));
      view.setUint32(80, count, true);
      corners.forEach((value, n) => view.setFloat32(84 + 50 * Math.floor(n / 9) + 12 + 4 * (n % 9), value, true));
      return bytes;
    };
    const text = words => new TextEncoder().encode(words).buffer;
    const shown = bytes => { try { return [...readStl(bytes)].join(); } catch (error) { return error.message; } };
    const one = [0, 0, 0, 1, 0, 0, 0, 1, 0];
    const facet = corners => "facet normal 0 0 0\n outer loop\n" + [0, 3, 6].map(at => "  vertex " + corners.slice(at, at + 3).join(" ")).join("\n") + "\n endloop\nendfacet\n";
"#;

#[test]
fn page_stl_of_both_kinds_is_read() {
    let program = format!(
        r#"{MAKE}
        console.log(shown(binary(one)));
        console.log(shown(binary(one, "solid made by a program")));
        console.log(shown(text("solid a\n" + facet(one) + facet(one.map(value => value * -1.5e-1)) + "endsolid a\n")));"#
    );
    prints(
        "page_stl_of_both_kinds_is_read",
        &program,
        "0,0,0,1,0,0,0,1,0\n0,0,0,1,0,0,0,1,0\n\
         0,0,0,1,0,0,0,1,0,0,0,0,-0.15000000596046448,0,0,0,-0.15000000596046448,0",
    );
}

#[test]
fn page_stl_damaged_names_its_fault() {
    let program = format!(
        r#"{MAKE}
        const whole = binary([...one, ...one]);
        for (const bytes of [new ArrayBuffer(0), text("solid"), text("hello"), whole.slice(0, 100), binary(one, "", 4000000000), binary([]),
          binary([NaN, ...one.slice(1)]), binary([1e30, ...one.slice(1)]), text("solid a\n" + facet(one)), text("solid a\nendsolid"),
          text("solid a\nfacet vertex 1 2 3\nendsolid"), text("solid a\n" + facet(one).replace("vertex 1", "vertex x") + "endsolid"),
          new ArrayBuffer(BYTES_MAX + 1)]) console.log(shown(bytes));
        // Cut anywhere, it is read as nothing else.
        let read = 0;
        for (let end = 0; end < whole.byteLength; end++) try {{ readStl(whole.slice(0, end)); read++; }} catch {{ }}
        console.log(read);
        const many = new ArrayBuffer(84 + 50 * (TRIANGLES_MAX + 1));
        new DataView(many).setUint32(80, TRIANGLES_MAX + 1, true);
        console.log(shown(many));"#
    );
    prints(
        "page_stl_damaged_names_its_fault",
        &program,
        "it is no STL file\nit is no STL file\nit is no STL file\n\
         it has 100 bytes; 2 triangles in its head need 184\n\
         it has 134 bytes; 4000000000 triangles in its head need 200000000084\n\
         it has no triangles\na corner of triangle 0 is at NaN\na corner of triangle 0 is at 1.0000000150474662e+30\n\
         it is cut off: it has no endsolid\nit has no triangles\n\
         it has 1 corners, which are no whole triangles\n`vertex x 0 0` is no corner\n\
         it has 16777217 bytes; at most 16777216 are read\n0\n\
         it has 200001 triangles; at most 200000 are drawn",
    );
}

#[test]
fn page_mesh_pieces_have_normals_and_bounds() {
    let program = format!(
        r#"{MAKE}
        const [piece] = pieces(Float32Array.from(one), [2, 2, 2]);
        console.log(piece.positions.join(), piece.normals.join(), piece.indices.join());
        // A mirrored one faces outwards still.
        console.log(pieces(Float32Array.from(one), [-1, 1, 1])[0].normals.join());
        const large = pieces(new Float32Array(9 * 50000), [1, 1, 1]);
        console.log(large.map(piece => piece.indices.length).join(), Math.max(...large[0].indices), large[0].normals.some(Number.isNaN));"#
    );
    prints(
        "page_mesh_pieces_have_normals_and_bounds",
        &program,
        "0,0,0,2,0,0,0,2,0 0,0,1,0,0,1,0,0,1 0,1,2\n\
         0,0,1,0,0,1,0,0,1\n65535,65535,18930 65534 false",
    );
}

//! Random and damaged sources, object codes and specifications.

use takt_irl::{System, compile, fuzz};
use takt_tests::fuzz::{feed, feed_files};

const SPEC: &str = include_str!("../../../examples/irl/two.spc");
const XML: &str = include_str!("../../../examples/irl/two.xml.spc");
const SOURCE: &str = include_str!("../../../examples/irl/palletize.irl");
const HEAD: &str = "program t; var i, n: int; x: real; b: bool; p: position; q: pose; j: mainjoint; e: event; a: array[1..3] of int;
    signal in part = \"part_present\"; out count = \"count\"; procedure act(inout k: int); begin k := k + 1; endproc; begin ";

/// The words of a text, each with the space behind it.
fn words(text: &str) -> Vec<&[u8]> {
    text.split_inclusive(' ').map(str::as_bytes).collect()
}

/// The parts of a text between `|`.
fn parts(text: &str) -> Vec<&[u8]> {
    text.split('|').map(str::as_bytes).collect()
}

#[test]
fn irl_sources_stand_random_input() {
    let text = "program p ; var x , y : int ; begin x := 1 + ( 2 ) * y ; if x < 3 then else endif ; while do endwhile ; \
                for to step endfor ; repeat until move ptp lin circle mainjoint act_rob \"lwr\" par endpar seq endseq wait sec \
                signal event procedure function endproc endfct return exit case of when default endcase array [ 1 .. 3 ] \
                record endrecord . @ real pose endprogram ; ";
    feed("irl_words", fuzz::source, &words(text), 4_000);
    feed_files("irl_source", fuzz::source, &[SOURCE.as_bytes()], 400);
}

#[test]
fn irl_statements_stand_random_input() {
    let text = "i := i + 1; |i := 2147483647; |a[i] := n; |a[4 - n] := |x := x / 0.5; |x := sqrt(x - 1) |; |b := not b; |b := i < n and b; \
                |if b then |elsif i = 2 then |else |endif; |while i < 9 do |endwhile; |repeat |until b; |for n := 1 to 3 do |endfor; \
                |case i of when 1: |when 2, 3: |default: |endcase; |par |endpar; |seq |endseq |wait 0.01 sec; |wait for part timeout 0.02; \
                |wait for e timeout 1; |signal event e; |count := i; |count := i * 90; |act(n); |return; |exit; |pause; |halt; |q := q @ q; \
                |p := (1, 2, 3); |p.x := x; |q := lwr.r_pose_act; |j := lwr.r_joint_act; |j.a1 := x; |(|)| + | * |i |x |b |p |1 |0 |-|0.5 \
                |move ptp j act_rob := \"lwr\"; |move ptp mainjoint(10, 0, 90, 0, 60, 0) act_rob := \"tx90\" c_ptp := 0.4; \
                |move_inc lin (0, 0, 30) act_rob := \"tx90\" c_cp := 20; |move_inc lin p act_rob := \"lwr\" time := 0.1; \
                |move_inc circle (5, 5, 0), (10, 0, 0) act_rob := \"tx90\" c_cp := x; |move lin q act_rob := \"lwr\" speed := x; \
                |timed_out |\"text\" |{ |} |endprogram; ";
    let statements = |data: &[u8]| {
        fuzz::source(&[HEAD.as_bytes(), data, b" endprogram;"].concat());
    };
    feed("irl_statements", statements, &parts(text), 3_000);
}

#[test]
fn irl_object_code_stands_damage() {
    let program = compile(SOURCE, &System::parse(SPEC).unwrap(), SPEC).unwrap();
    let code = program.program.encode();
    feed_files("irl_code", fuzz::code, &[&code], 1_000);
}

#[test]
fn irl_specifications_stand_random_input() {
    let text = "[[robot]] [[signal]] [ ] = , ' { } name model joints min max speed acceleration jerk home base tool direction in out kind \
                digital analog binary channel bits io : 0 1 -1 1e9 nan \n <system> </system> <robot </robot> <joint <signal <home <tool / > \" ";
    let parse = fuzz::specification;
    feed("irl_specification_words", parse, &words(text), 3_000);
    let files = [SPEC.as_bytes(), XML.as_bytes()];
    feed_files("irl_specification", parse, &files, 3_000);
}

;; Whether a migrating coordinator's block is fully valid, as lfield/vm/memory/block_verifier.py. 1: valid; 0:
;; undecided, Python decides. The caller has compared the words before its top.
;;
;; $tables, $block, $top, $starts, $tickets   as for $verify_heap
;; $suspension_points   address of the tables of suspension points

(func $can_migrate (export "can_migrate")
    (param $tables i32) (param $suspension_points i32) (param $block i32) (param $top i64) (param $starts i32)
    (param $tickets i32)
    (result i32)
    (local $class i64) (local $thread i64) (local $address i32)
    (block $undecided
        ;; The header: top, interval, clock, tickets, hops, class.
        (br_if $undecided (i64.lt_u (local.get $top) (i64.const 35)))
        (br_if $undecided (i64.ne (i64.load offset=40 (local.get $block)) (local.get $top)))
        (br_if $undecided (i64.gt_u (i64.load offset=256 (local.get $block)) (i64.const 86400000)))
        (br_if $undecided (i64.ge_u (i64.load offset=264 (local.get $block)) (i64.const 0x4000000000000000)))
        (br_if $undecided (i64.ge_u (i64.load offset=272 (local.get $block)) (i64.const 0x4000000000000000)))
        (br_if $undecided (i64.ge_u (i64.load offset=120 (local.get $block)) (i64.const 0x1000000000000)))
        (local.set $class (i64.load offset=48 (local.get $block)))
        (br_if $undecided
            (i64.ge_u (local.get $class) (i64.extend_i32_u (i32.load (local.get $suspension_points)))))
        (br_if $undecided
            (i32.eqz
                (i32.load8_u
                    (i32.add
                        (i32.add (local.get $suspension_points) (i32.load offset=4 (local.get $suspension_points)))
                        (i32.wrap_i64 (local.get $class))))))
        ;; The heap; Python checks the rest of tickets.
        (br_if $undecided
            (call $verify_heap (local.get $tables) (local.get $block) (i64.const 35) (local.get $top)
                (local.get $starts) (local.get $tickets)))
        ;; The roots: the object, its id, one thread that serves no call, and is the only possible monitor owner.
        (br_if $undecided
            (i32.ne
                (call $header_at (local.get $block) (local.get $top) (local.get $starts)
                    (i64.load offset=56 (local.get $block)))
                (i32.or (i32.const 1) (i32.shl (i32.wrap_i64 (local.get $class)) (i32.const 8)))))
        (br_if $undecided
            (i32.ne
                (call $header_at (local.get $block) (local.get $top) (local.get $starts)
                    (i64.load offset=64 (local.get $block)))
                (i32.const 3)))
        (local.set $thread (i64.load offset=72 (local.get $block)))
        (br_if $undecided
            (i32.ne
                (call $header_at (local.get $block) (local.get $top) (local.get $starts) (local.get $thread))
                (i32.const 6)))
        (local.set $address (call $address (local.get $block) (local.get $thread)))
        (br_if $undecided (i64.ne (i64.load offset=40 (local.get $address)) (i64.const 0)))
        (br_if $undecided (i64.ne (i64.load offset=48 (local.get $address)) (i64.const 0)))
        (if (i64.ne (i64.load offset=88 (local.get $block)) (i64.const 0))
            (then
                (br_if $undecided
                    (i64.ne
                        (i64.load offset=88 (local.get $block))
                        (i64.load offset=8 (local.get $address))))))
        (return
            (call $verify_frames (local.get $suspension_points) (local.get $block) (local.get $top) (local.get $starts)
                (i64.load offset=24 (local.get $address)) (i64.load offset=32 (local.get $address)))))
    (i32.const 0))

;; Whether frames are one chain, each after its call, of methods that reserve nothing, and the first of them at
;; an instruction where coordinators migrate.
(func $verify_frames
    (param $suspension_points i32) (param $block i32) (param $top i64) (param $starts i32) (param $frame i64)
    (param $pc i64)
    (result i32)
    (local $calls i32) (local $header_low i32) (local $method i32) (local $callee i32) (local $depth i64)
    (local $address i32)
    (local.set $calls (i32.add (local.get $suspension_points) (i32.load offset=12 (local.get $suspension_points))))
    (local.set $callee (i32.const -1))
    (block $undecided
        (br_if $undecided
            (i64.ge_u (local.get $pc) (i64.extend_i32_u (i32.load offset=8 (local.get $suspension_points)))))
        (br_if $undecided
            (i32.ne
                (i32.load (call $number (local.get $calls) (local.get $pc)))
                (i32.const -2)))
        (loop $next
            (local.set $header_low
                (call $header_at (local.get $block) (local.get $top) (local.get $starts) (local.get $frame)))
            (br_if $undecided (i32.ne (i32.and (local.get $header_low) (i32.const 255)) (i32.const 5)))
            (local.set $address (call $address (local.get $block) (local.get $frame)))
            (local.set $method
                (i32.add
                    (i32.add (local.get $suspension_points) (i32.load offset=16 (local.get $suspension_points)))
                    (i32.mul (i32.shr_u (local.get $header_low) (i32.const 8)) (i32.const 12))))
            (br_if $undecided
                (i64.le_s (local.get $pc) (i64.load32_s (local.get $method))))
            (br_if $undecided
                (i64.ge_s (local.get $pc) (i64.load32_s offset=4 (local.get $method))))
            (br_if $undecided (i32.load offset=8 (local.get $method)))
            (if (i32.ge_s (local.get $callee) (i32.const 0))
                (then
                    (br_if $undecided
                        (i64.ne
                            (i64.load offset=24 (local.get $address))
                            (i64.sub (local.get $depth) (i64.const 1))))
                    (br_if $undecided
                        (i32.ne
                            (i32.load
                                (call $number (local.get $calls)
                                    (i64.sub (local.get $pc) (i64.const 1))))
                            (local.get $callee)))))
            (local.set $callee (i32.shr_u (local.get $header_low) (i32.const 8)))
            (local.set $depth (i64.load offset=24 (local.get $address)))
            (local.set $pc (i64.load offset=16 (local.get $address)))
            (local.set $frame (i64.load offset=8 (local.get $address)))
            (br_if $undecided (i64.lt_s (local.get $depth) (i64.const 1)))
            (br_if $next (i64.ne (local.get $frame) (i64.const 0)))
            (return (i64.eq (local.get $depth) (i64.const 1)))))
    (i32.const 0))

;; The lower half of the header of the object at a word of the heap; 255 where none starts.
(func $header_at (param $block i32) (param $top i64) (param $starts i32) (param $index i64) (result i32)
    (if (i64.ge_u (local.get $index) (local.get $top)) (then (return (i32.const 255))))
    (if (i32.and
            (i32.shr_u
                (i32.load8_u
                    (i32.add
                        (local.get $starts)
                        (i32.wrap_i64 (i64.shr_u (local.get $index) (i64.const 3)))))
                (i32.and (i32.wrap_i64 (local.get $index)) (i32.const 7)))
            (i32.const 1))
        (then (return (i32.load (call $address (local.get $block) (local.get $index))))))
    (i32.const 255))

;; The address of one element of an array of 32-bit numbers.
(func $number (param $first i32) (param $index i64) (result i32)
    (i32.add (local.get $first) (i32.shl (i32.wrap_i64 (local.get $index)) (i32.const 2))))

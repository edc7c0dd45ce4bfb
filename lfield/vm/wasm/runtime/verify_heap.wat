;; Whether the heap of a block is valid, as lfield/vm/memory/block_verifier.py, or undecided. -1: undecided, Python
;; decides; else every size, text, proxy and reference is valid, and the result is the number of tickets on the
;; heap. Python checks the rest of a ticket.
;;
;; $tables   address of the tables: the records of memory.wat (first number: the size of the object, 0 any,
;;           -1 no such object; second: target type of the elements of an array of references), then sixteen
;;           numbers of records by kind, then two pairs: members and the address of their classes, classes and
;;           the address of their superclass bits
;; $block    address of the block; $heap and $top in words
;; $starts   address of one bit for every word of the block, set at the start of an object
;; $tickets  address of 64 bits for every possible ticket, for their indices

(func $verify_heap (export "verify_heap")
    (param $tables i32) (param $block i32) (param $heap i64) (param $top i64) (param $starts i32)
    (param $tickets i32)
    (result i32)
    (local $count i32)
    (memory.fill (local.get $starts) (i32.const 0)
        (i32.wrap_i64 (i64.shr_u (i64.add (local.get $top) (i64.const 7)) (i64.const 3))))
    (local.set $count
        (call $verify_objects (local.get $tables) (local.get $block) (local.get $heap) (local.get $top)
            (local.get $starts) (local.get $tickets)))
    (if (i32.ge_s (local.get $count) (i32.const 0))
        (then
            (if (call $verify_references (local.get $tables) (local.get $block) (local.get $heap)
                    (local.get $top) (local.get $starts))
                (then (return (local.get $count))))))
    (i32.const -1))

;; The number of tickets on the heap, whose objects must follow one another up to the top with valid headers;
;; -1 if they do not.
(func $verify_objects
    (param $tables i32) (param $block i32) (param $index i64) (param $top i64) (param $starts i32)
    (param $tickets i32)
    (result i32)
    (local $count i32) (local $address i32) (local $header i64) (local $header_low i32) (local $kind i32)
    (local $words i64) (local $size i32)
    (local $bit i32)
    (block $undecided
        (loop $next
            (if (i64.ge_u (local.get $index) (local.get $top))
                (then (return (local.get $count))))
            (local.set $address (call $address (local.get $block) (local.get $index)))
            (local.set $header (i64.load (local.get $address)))
            (local.set $header_low (i32.wrap_i64 (local.get $header)))
            (local.set $kind (i32.and (local.get $header_low) (i32.const 255)))
            (local.set $words (i64.shr_s (local.get $header) (i64.const 32)))
            (br_if $undecided (i32.gt_u (local.get $kind) (i32.const 15)))
            (br_if $undecided
                (i32.ge_u
                    (i32.shr_u (local.get $header_low) (i32.const 8))
                    (i32.load offset=64
                        (i32.add (local.get $tables) (i32.shl (local.get $kind) (i32.const 2))))))
            (local.set $size (i32.load (call $record (local.get $tables) (local.get $header_low))))
            (br_if $undecided (i32.lt_s (local.get $size) (i32.const 0)))
            (br_if $undecided (i64.le_s (local.get $words) (i64.const 0)))
            (br_if $undecided
                (i64.gt_s (i64.add (local.get $index) (local.get $words)) (local.get $top)))
            (br_if $undecided
                (i32.and
                    (i32.ne (local.get $size) (i32.const 0))
                    (i64.ne (i64.extend_i32_u (local.get $size)) (local.get $words))))
            (if (i32.eq (local.get $kind) (i32.const 3))
                (then
                    (br_if $undecided
                        (i32.eqz (call $is_text (local.get $address) (local.get $words))))))
            (if (i32.eq (local.get $kind) (i32.const 4))
                (then
                    (br_if $undecided
                        (i32.eqz
                            (call $is_proxy (local.get $tables) (local.get $address)
                                (i32.shr_u (local.get $header_low) (i32.const 8)))))))
            (if (i32.eq (local.get $kind) (i32.const 7))
                (then
                    (i64.store (local.get $tickets) (local.get $index))
                    (local.set $tickets (i32.add (local.get $tickets) (i32.const 8)))
                    (local.set $count (i32.add (local.get $count) (i32.const 1)))))
            (local.set $bit
                (i32.add (local.get $starts) (i32.wrap_i64 (i64.shr_u (local.get $index) (i64.const 3)))))
            (i32.store8 (local.get $bit)
                (i32.or
                    (i32.load8_u (local.get $bit))
                    (i32.shl
                        (i32.const 1)
                        (i32.and (i32.wrap_i64 (local.get $index)) (i32.const 7)))))
            (local.set $index (i64.add (local.get $index) (local.get $words)))
            (br $next)))
    (i32.const -1))

;; Whether every reference leads to the start of an object of its type.
(func $verify_references
    (param $tables i32) (param $block i32) (param $index i64) (param $top i64) (param $starts i32)
    (result i32)
    (local $address i32) (local $header i64) (local $record i32) (local $remaining i32) (local $list i32)
    (local $offset i32) (local $expected i32) (local $target i64) (local $found i32)
    (block $undecided
        (loop $next
            (if (i64.ge_u (local.get $index) (local.get $top)) (then (return (i32.const 1))))
            (local.set $address (call $address (local.get $block) (local.get $index)))
            (local.set $header (i64.load (local.get $address)))
            (local.set $index (i64.add (local.get $index) (i64.shr_u (local.get $header) (i64.const 32))))
            (local.set $record (call $record (local.get $tables) (i32.wrap_i64 (local.get $header))))
            ;; A growable array has at most as many elements as its array, which is checked below.
            (if (i32.eq (i32.and (i32.wrap_i64 (local.get $header)) (i32.const 255)) (i32.const 8))
                (then
                    (local.set $target (i64.load offset=16 (local.get $address)))
                    (br_if $undecided (i64.eqz (local.get $target)))
                    (br_if $undecided (i64.ge_u (local.get $target) (local.get $top)))
                    (br_if $undecided
                        (i64.ge_u
                            (i64.load offset=8 (local.get $address))
                            (i64.load32_u offset=4
                                (call $address (local.get $block) (local.get $target)))))))
            (local.set $remaining (i32.load offset=4 (local.get $record)))
            (local.set $offset (i32.const 0))
            (local.set $list (i32.const 0))
            (if (i32.lt_s (local.get $remaining) (i32.const 0))
                (then
                    (local.set $remaining
                        (i32.sub
                            (i32.wrap_i64 (i64.shr_u (local.get $header) (i64.const 32)))
                            (i32.const 1)))
                    (local.set $expected (i32.load offset=12 (local.get $record))))
                (else
                    (local.set $list
                        (i32.add (local.get $tables) (i32.load offset=8 (local.get $record))))))
            (loop $reference
                (br_if $next (i32.eqz (local.get $remaining)))
                (local.set $remaining (i32.sub (local.get $remaining) (i32.const 1)))
                (if (local.get $list)
                    (then
                        (local.set $offset (i32.load (local.get $list)))
                        (local.set $expected (i32.load offset=4 (local.get $list)))
                        (local.set $list (i32.add (local.get $list) (i32.const 8))))
                    (else
                        (local.set $offset (i32.add (local.get $offset) (i32.const 8)))))
                (local.set $target (i64.load (i32.add (local.get $address) (local.get $offset))))
                (br_if $reference (i64.eqz (local.get $target)))
                (br_if $undecided (i64.ge_u (local.get $target) (local.get $top)))
                (br_if $undecided
                    (i32.eqz
                        (i32.and
                            (i32.shr_u
                                (i32.load8_u
                                    (i32.add
                                        (local.get $starts)
                                        (i32.wrap_i64 (i64.shr_u (local.get $target) (i64.const 3)))))
                                (i32.and (i32.wrap_i64 (local.get $target)) (i32.const 7)))
                            (i32.const 1))))
                (local.set $found (i32.load (call $address (local.get $block) (local.get $target))))
                ;; The sentinel of a `together` is a ticket without a number.
                (if (i32.eq (local.get $expected) (i32.const -6))
                    (then
                        (br_if $undecided (i32.ne (local.get $found) (i32.const 7)))
                        (br_if $undecided
                            (i64.ne
                                (i64.load offset=64 (call $address (local.get $block) (local.get $target)))
                                (i64.const 0)))
                        (br $reference)))
                (br_if $reference (i32.eq (local.get $found) (local.get $expected)))
                (br_if $reference
                    (call $is_kind (local.get $tables) (local.get $found) (local.get $expected)))
                (br $undecided))))
    (i32.const 0))

;; Whether a target is of the expected kind (-1: any object, -2: proxy, -3: frame, -4: array, -5: ticket),
;; or an object of a subclass of the expected class.
(func $is_kind (param $tables i32) (param $found i32) (param $expected i32) (result i32)
    (local $kind i32) (local $bit i32)
    (local.set $kind (i32.and (local.get $found) (i32.const 255)))
    (if (i32.eq (local.get $expected) (i32.const -2))
        (then (return (i32.eq (local.get $kind) (i32.const 4)))))
    (if (i32.eq (local.get $expected) (i32.const -3))
        (then (return (i32.eq (local.get $kind) (i32.const 5)))))
    (if (i32.eq (local.get $expected) (i32.const -4))
        (then (return (i32.eq (local.get $kind) (i32.const 2)))))
    (if (i32.eq (local.get $expected) (i32.const -5))
        (then (return (i32.eq (local.get $kind) (i32.const 7)))))
    (if (i32.ne (local.get $kind) (i32.const 1))
        (then (return (i32.const 0))))
    (if (i32.eq (local.get $expected) (i32.const -1)) (then (return (i32.const 1))))
    (if (i32.ne (i32.and (local.get $expected) (i32.const 255)) (i32.const 1))
        (then (return (i32.const 0))))
    (local.set $bit
        (i32.add
            (i32.mul
                (i32.shr_u (local.get $found) (i32.const 8))
                (i32.load offset=136 (local.get $tables)))
            (i32.shr_u (local.get $expected) (i32.const 8))))
    (i32.and
        (i32.shr_u
            (i32.load8_u
                (i32.add
                    (i32.add (local.get $tables) (i32.load offset=140 (local.get $tables)))
                    (i32.shr_u (local.get $bit) (i32.const 3))))
            (i32.and (local.get $bit) (i32.const 7)))
        (i32.const 1)))

;; Whether a proxy refers to a resource of its type, with a valid incarnation of its host.
(func $is_proxy (param $tables i32) (param $address i32) (param $class i32) (result i32)
    (local $member i64)
    (local.set $member (i64.load offset=8 (local.get $address)))
    (if (i64.ge_u (local.get $member) (i64.extend_i32_u (i32.load offset=128 (local.get $tables))))
        (then (return (i32.const 0))))
    (i32.and
        (i32.eq
            (i32.load
                (i32.add
                    (i32.add (local.get $tables) (i32.load offset=132 (local.get $tables)))
                    (i32.shl (i32.wrap_i64 (local.get $member)) (i32.const 2))))
            (local.get $class))
        (i64.lt_u (i64.load offset=16 (local.get $address)) (i64.const 0x4000000000000000))))

;; Whether a string has the length in its header and is UTF-8: shortest encodings, no surrogates, nothing beyond
;; the last code point.
(func $is_text (param $address i32) (param $words i64) (result i32)
    (local $length i64) (local $end i32) (local $lead i32) (local $second i32) (local $more i32)
    (if (i64.lt_s (local.get $words) (i64.const 2)) (then (return (i32.const 0))))
    (local.set $length (i64.load offset=8 (local.get $address)))
    (if (i64.gt_u
            (local.get $length)
            (i64.shl (i64.sub (local.get $words) (i64.const 2)) (i64.const 3)))
        (then (return (i32.const 0))))
    (local.set $address (i32.add (local.get $address) (i32.const 16)))
    (local.set $end (i32.add (local.get $address) (i32.wrap_i64 (local.get $length))))
    (block $wrong
        (loop $next
            ;; Eight bytes of ASCII at once.
            (if (i32.ge_u (i32.sub (local.get $end) (local.get $address)) (i32.const 8))
                (then
                    (if (i64.eqz
                            (i64.and
                                (i64.load align=1 (local.get $address))
                                (i64.const 0x8080808080808080)))
                        (then
                            (local.set $address (i32.add (local.get $address) (i32.const 8)))
                            (br $next)))))
            (if (i32.eq (local.get $address) (local.get $end)) (then (return (i32.const 1))))
            (local.set $lead (i32.load8_u (local.get $address)))
            (local.set $address (i32.add (local.get $address) (i32.const 1)))
            (br_if $next (i32.lt_u (local.get $lead) (i32.const 0x80)))
            (br_if $wrong (i32.lt_u (local.get $lead) (i32.const 0xC2)))
            (br_if $wrong (i32.gt_u (local.get $lead) (i32.const 0xF4)))
            (local.set $more
                (i32.add
                    (i32.const 1)
                    (i32.add
                        (i32.ge_u (local.get $lead) (i32.const 0xE0))
                        (i32.ge_u (local.get $lead) (i32.const 0xF0)))))
            (br_if $wrong (i32.lt_u (i32.sub (local.get $end) (local.get $address)) (local.get $more)))
            (local.set $second (i32.load8_u (local.get $address)))
            (br_if $wrong
                (i32.and
                    (i32.eq (local.get $lead) (i32.const 0xE0))
                    (i32.lt_u (local.get $second) (i32.const 0xA0))))
            (br_if $wrong
                (i32.and
                    (i32.eq (local.get $lead) (i32.const 0xED))
                    (i32.gt_u (local.get $second) (i32.const 0x9F))))
            (br_if $wrong
                (i32.and
                    (i32.eq (local.get $lead) (i32.const 0xF0))
                    (i32.lt_u (local.get $second) (i32.const 0x90))))
            (br_if $wrong
                (i32.and
                    (i32.eq (local.get $lead) (i32.const 0xF4))
                    (i32.gt_u (local.get $second) (i32.const 0x8F))))
            (loop $trail
                (br_if $wrong
                    (i32.ne
                        (i32.and (i32.load8_u (local.get $address)) (i32.const 0xC0))
                        (i32.const 0x80)))
                (local.set $address (i32.add (local.get $address) (i32.const 1)))
                (br_if $trail (local.tee $more (i32.sub (local.get $more) (i32.const 1)))))
            (br $next)))
    (i32.const 0))
